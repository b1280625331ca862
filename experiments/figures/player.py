"""Take the documentation's screenshots of the page of `mapf-pz render`: `python -m experiments.figures.player`.

It requires Chromium and the package playwright.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from mapf_pz.commands.main import main

IMAGES = Path(__file__).parents[2] / "docs" / "images"
EPISODE = "--policy mappo --map random-24-24-20 --num-agents 40 --max-steps 256"
SHOWN = "#t=22&agent=3"
FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update")


def run() -> None:
    """Write the page, and take screenshots with the light and the dark theme."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        file = Path(folder) / "episode.html"
        if main(["render", str(file), *EPISODE.split()]):
            raise SystemExit(1)
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
        for theme in ("light", "dark"):
            page = browser.new_page(viewport={"width": 1200, "height": 760}, color_scheme=theme)  # pyright: ignore[reportArgumentType]
            page.goto(file.as_uri() + SHOWN)
            page.wait_for_selector("body[data-ready]")
            page.wait_for_timeout(300)
            page.screenshot(path=IMAGES / f"player-{theme}.png")
        browser.close()


if __name__ == "__main__":
    run()
