"""How fast the page of `mapf-pz render` opens and plays.

It requires Chromium and the package playwright.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from experiments.figures.player import FLAGS
from mapf_pz.commands.main import main as mapf_pz

EPISODE = "--policy pibt --map warehouse-20-40-10-2-2 --num-agents 1000 --max-steps 1000 --on-target restart"
REPEATS = 3
SECONDS = 4
"""Duration of a measurement of frames."""
COUNT_FRAMES = """(seconds) => new Promise((resolve) => {
    let frames = 0;
    const start = performance.now();
    const count = (now) => {
        if (now - start > 1000 * seconds) resolve((1000 * frames) / (now - start));
        else { frames += 1; requestAnimationFrame(count); }
    };
    requestAnimationFrame(count);
})"""
"""Returns the number of frames per second."""


def frames(page: Page, speed: int, setup: str) -> float:
    """Return how many frames per second the page draws while it plays at `speed` steps per second."""
    page.evaluate(f"player.play(false); player.seek(0); player.fit(); {setup}")
    page.select_option("#speed", str(speed))
    page.evaluate("player.play(true)")
    return page.evaluate(COUNT_FRAMES, SECONDS)


def main() -> None:
    """Write a page, and print its size, the time until it is ready, and the frames per second."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        file = Path(folder) / "episode.html"
        if mapf_pz(["render", str(file), *EPISODE.split()]):
            raise SystemExit(1)
        print(f"size: {file.stat().st_size / 1e6:.2f} MB")
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
        page = browser.new_page(viewport={"width": 1200, "height": 720})
        for _ in range(REPEATS):
            start = time.perf_counter()
            page.goto(file.as_uri())
            page.wait_for_selector("body[data-ready]")
            print(f"ready after {time.perf_counter() - start:.2f} s")
        for speed in (4, 16):
            print(f"whole map, {speed} steps per second: {frames(page, speed, ''):.0f} frames per second")
        print(
            f"zoomed in, an agent selected: {frames(page, 4, 'player.zoom(4); player.choose(3)'):.0f} frames per second"
        )
        browser.close()
