"""Take the documentation's screenshots of the page of `mapf-pz edit`: `python -m experiments.figures.editor`.

It requires Chromium and the package playwright.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile

from playwright.sync_api import Page, sync_playwright

from experiments.figures.player import FLAGS, IMAGES
from tests.helpers.drawing_page import stroke

Cell = tuple[int, int]
DOOR: tuple[tuple[Cell, Cell], ...] = (((0, 4), (6, 4)), ((3, 4), (3, 4)))
"""A wall, and the door that is erased from it: first and last cells."""
AGENTS: tuple[tuple[Cell, Cell], ...] = (
    ((1, 1), (5, 7)),
    ((5, 1), (1, 7)),
    ((1, 6), (3, 0)),
    ((6, 8), (0, 0)),
)
"""Starts and goals."""


def main() -> None:
    """Start a server, draw the instance of the tutorial, solve it, and take the screenshots."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        words = [sys.executable, "-m", "mapf_pz", "edit", "--no-browser", "--folder", folder]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as server:
            assert server.stdout is not None
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
            page = browser.new_page(viewport={"width": 1100, "height": 640}, color_scheme="light")
            page.set_default_timeout(120_000)
            page.goto(server.stdout.readline().strip())
            page.wait_for_selector("body[data-ready]")
            _draw(page)
            page.screenshot(path=IMAGES / "editor-drawing.png")
            _solve(page, "lacam", "oneshot+pibt")
            page.screenshot(path=IMAGES / "editor-solved.png")
            browser.close()
            server.terminate()


def _draw(page: Page) -> None:
    """Draw two rooms with a door, and agents that go through it."""
    page.fill("#rows", "7")
    page.fill("#cols", "9")
    page.click("#new")
    wall, door = DOOR
    stroke(page, *wall)
    page.keyboard.press("e")
    stroke(page, *door)
    page.keyboard.press("a")
    for start, goal in AGENTS:
        stroke(page, start, goal)
    page.fill("#name", "door")
    page.evaluate("document.activeElement.blur()")


def _solve(page: Page, first: str, second: str) -> None:
    """Solve with two solvers, and show a step in the middle, with an agent and its decision."""
    page.fill("#solver-a", first)
    page.fill("#solver-b", second)
    page.click("#solve")
    page.wait_for_selector("body[data-played]")
    page.evaluate("player.show(9, 1)")
    page.wait_for_timeout(300)


if __name__ == "__main__":
    main()
