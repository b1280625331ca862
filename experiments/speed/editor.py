"""How often the editor's page draws a large map while a wall is drawn.

It requires Chromium and the package playwright. Chromium draws at most 60 times a second.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from experiments.figures.player import FLAGS
from mapf_pz.editor import save_editor

MAP = Path("maps/Berlin_1_256.map")
AGENTS = 500
FRAMES = 120
MEASURE = """async (frames) => {
    editor.set({ tool: "draw" });
    editor.press([100, 10]);
    const start = performance.now();
    let script = 0;
    for (let frame = 0; frame < frames; frame++) {
        const before = performance.now();
        editor.drag([100 + (frame % 50), 10 + frame]);
        editor.faults();
        editor.board.draw(editor.shown());
        script += performance.now() - before;
        await new Promise(requestAnimationFrame);
    }
    const seconds = (performance.now() - start) / 1000;
    editor.release();
    return [frames / seconds, script / frames];
}"""


def main() -> None:
    """Open a map, add random agents, and print the frames a second and the time of a frame's script, three times."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        file = Path(folder) / "editor.html"
        save_editor(file)
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
        page = browser.new_page(viewport={"width": 1200, "height": 800})
        page.goto(file.as_uri())
        page.wait_for_selector("body[data-ready]")
        page.set_input_files("#open-files", MAP)
        page.wait_for_function(f"editor.drawing.name === '{MAP.stem}'")
        page.fill("#random-count", str(AGENTS))
        page.click("#add-agents")
        page.wait_for_function(f"editor.drawing.agents.length === {AGENTS}")
        for _ in range(3):
            rate, script = page.evaluate(MEASURE, FRAMES)
            print(f"{MAP.stem}, {AGENTS} agents: {rate:.0f} frames/s, {script:.1f} ms of script a frame")
        browser.close()
