"""Take the documentation's screenshots of the page of `mapf-pz render`: `python experiments/screenshots.py`.

It requires Chromium and the package playwright.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from mapf_pz.cli import main

IMAGES = Path(__file__).parents[1] / "docs" / "images"
EPISODE = "--policy mappo+pibt --map warehouse-10-20-10-2-1 --num-agents 100 --max-steps 512"
FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update")


def take(page: Page, theme: str) -> None:
    """Follow an agent, and take a screenshot."""
    page.evaluate("player.zoom(2.2, player.box.width / 2, player.box.height / 2); player.choose(0); player.seek(40)")
    page.check("#follow")
    page.wait_for_timeout(300)
    page.screenshot(path=IMAGES / f"player-{theme}.png")


def run() -> None:
    """Write the page, and take screenshots with the light and the dark theme."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        file = Path(folder) / "episode.html"
        if main(["render", str(file), *EPISODE.split()]):
            raise SystemExit(1)
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
        for theme in ("light", "dark"):
            page = browser.new_page(viewport={"width": 1200, "height": 720}, color_scheme=theme)  # pyright: ignore[reportArgumentType]
            page.goto(file.as_uri())
            page.wait_for_selector("body[data-ready]")
            take(page, theme)
        browser.close()


if __name__ == "__main__":
    run()
