"""Draw a step of an execution under delays, as its page shows it: `python -m experiments.figures.delays`.

It requires Chromium and the package playwright.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from experiments.figures.player import FLAGS, IMAGES
from mapf_pz.commands.main import main
from mapf_pz.instances import load_map, write_map

MAP = """
    .............
    .@@@@.@@@@@@.
    .@@@@.@@@@@@.
    .............
    .@@@@@@.@@@@.
    .@@@@@@.@@@@.
    .............
    .@@@@.@@@@@@.
    .............
"""
PLANNER = "--planner lacam:clock=work --num-agents 16 --action-model cardinal --time-limit 2"
DELAYS = "--delays 0.06:2-4"
SHOWN = "#t=7"
CELL = 40
"""Side length of a cell, in px."""
DRAW = """(cell) => {
    const [view] = player.views, { camera } = view;
    const [boxWidth, boxHeight] = [camera.width, camera.height].map((side) => side * cell);
    Object.assign(camera, { scale: cell, left: 0, top: 0, boxWidth, boxHeight });
    return view.svg(player.time);
}"""
"""Returns the whole map at a scale, without a margin."""


def run() -> None:
    """Solve, execute the plan, and save a step of the page."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        map, plan, file = (Path(folder) / name for name in ("corridors.map", "plan.json", "execution.html"))
        write_map(load_map(MAP), map)
        for words in (
            ["solve", str(plan), "--map", str(map), *PLANNER.split()],
            ["execute", str(plan), "--map", str(map), *DELAYS.split(), "--page", str(file)],
        ):
            if main(words):
                raise SystemExit(1)
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
        page = browser.new_page(color_scheme="light")
        page.goto(file.as_uri() + SHOWN)
        page.wait_for_selector("body[data-ready]")
        (IMAGES / "delays.svg").write_text(page.evaluate(DRAW, CELL), "utf-8")
        browser.close()


if __name__ == "__main__":
    run()
