"""The command `mapf-pz edit`: a page on which maps and scenarios are edited, and solved."""

from __future__ import annotations

import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Annotated, Any

from tyro.conf import Positional, UseAppendAction

from mapf_pz._internal.plugins import imported_object
from mapf_pz._internal.text import read_text
from mapf_pz.editor import save_editor
from mapf_pz.editor.folders import Folders
from mapf_pz.instances import format_scenario, load_map, load_scenario
from mapf_pz.instances.library import map_file, scenario_map, scenario_name
from mapf_pz.planners.named import import_code, own_code


@dataclass(frozen=True)
class EditOptions:
    """Options of `mapf-pz edit`: the files to open, and the folders of files."""

    map: Positional[str | None] = None
    """Map to open: its name, or a `.map` file."""
    scenario: str | None = None
    """Scenario to open: its name, such as `random-1`, or a `.scen` file. Without a map, the map that it names is
    opened."""
    folder: tuple[Path, ...] = ()
    """Folders in which the page may read and write files. Default: the working directory, and the folders of the given
    files."""
    solver: Annotated[tuple[str, ...], UseAppendAction] = ()
    """Planner or policy of your own, `package.module:Class`, that the page offers; may be given several times."""
    port: int = 0
    """Port of the server. 0: a free one."""
    browser: bool = True
    """Open the page in the browser."""
    output: Path | None = None
    """Write the page to this `.html` file instead of serving it. It draws instances and plays plans, in any browser and
    without this package; it does not run solvers."""


def edit(options: EditOptions) -> None:
    """Edit maps and scenarios on a page in the browser, run planners and policies on them, and play plans.

    The page is served on this machine only, at the address that is printed. Ctrl-C ends the server.
    """
    if options.output is not None:
        _save(options, options.output)
        return
    folders = options.folder or (Path(), *(Path(file).parent for file in _given_files(options)))
    for solver in options.solver:
        if own_code(solver) == solver:
            import_code(solver)
        if not isinstance(imported_object(solver), type):
            raise ValueError(f"--solver {solver}: expected package.module:Class")
    _serve(_start(options), folders, options)


def _save(options: EditOptions, output: Path) -> None:
    if output.suffix.lower() != ".html" or options.folder or options.solver or options.port:
        raise ValueError("--output: expected an .html file, and neither --folder, --solver nor --port")
    output.parent.mkdir(parents=True, exist_ok=True)
    save_editor(output, _start(options))
    print(f"{output}: draw on this page, or drop maps, scenarios and plans on it")


def _given_files(options: EditOptions) -> list[str]:
    """Return the files among the map and the scenario, which may also be names."""
    return [file for file in (options.map, options.scenario) if file is not None and file.endswith((".map", ".scen"))]


def _start(options: EditOptions) -> dict[str, Any]:
    """Return the files that the page opens, each None or its `name` and `text`; raises as `load_map` and others."""
    map, scenario = options.map, options.scenario
    if map is None and scenario is not None:
        map = scenario_map(scenario)
    if map is None:
        return {"map": None, "scenario": None}
    file, grid = map_file(map), load_map(map)
    if file.suffix != ".map":
        raise ValueError(f"{map}: expected a name, or a .map file")
    opened = {"name": file.name, "text": read_text(file)}
    if scenario is None:
        return {"map": opened, "scenario": None}
    agents, name = load_scenario(scenario, grid), Path(scenario_name(scenario, grid.name)).name.removesuffix(".scen")
    text = read_text(scenario) if scenario.endswith(".scen") else format_scenario(agents, grid)
    return {"map": opened, "scenario": {"name": f"{name}.scen", "text": text}}


def _serve(start: dict[str, Any], folders: Sequence[Path], options: EditOptions) -> None:
    try:
        from mapf_pz.editor.server import serve
    except ModuleNotFoundError as error:
        raise ImportError(f"{error}: pip install 'mapf-pz[edit]'") from error

    def show(address: str) -> None:
        print(address, flush=True)
        if options.browser:  # in a thread, as a browser in the terminal would be waited for
            Thread(target=webbrowser.open, args=(address,), daemon=True).start()

    serve(Folders(folders), start, options.port, show, options.solver)
