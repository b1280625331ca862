"""What the page offers by name: maps, scenarios, problems, guidance graphs, families of maps, planners and policies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, NamedTuple

from mapf_pz._internal.json import parse_object, text_member
from mapf_pz._internal.plugins import imported_object
from mapf_pz._internal.signatures import field_docs
from mapf_pz._internal.suggest import expected_names
from mapf_pz._internal.text import read_text
from mapf_pz.editor.folders import Folders
from mapf_pz.editor.instances import check_shape, grid_of, weights_text
from mapf_pz.editor.requests import GenerateRequest, GraphRequest, OpenRequest, Refusal
from mapf_pz.evaluation.policies import bundled_policies
from mapf_pz.guidance.library import GENERATED, guidance_graph, guidance_names
from mapf_pz.instances import (
    MapMixture,
    format_scenario,
    load_map,
    load_problem,
    load_scenario,
    read_problem,
)
from mapf_pz.instances.benchmarks.lorr import problem_names
from mapf_pz.instances.files.lorr import format_problem
from mapf_pz.instances.library import map_paths, scenario_names
from mapf_pz.planners import PLANNERS
from mapf_pz.planners.named import default_options

FILE_MEMBERS = {"map": "mapFile", "agents": "agentFile", "tasks": "taskFile"}
"""The members of a problem's JSON that name its other files, by kind of file."""


class Family(NamedTuple):
    """A family of generated maps."""

    summary: str
    """One-line description."""
    options: tuple[str, ...]
    """The fields of `MapMixture` that matter to it."""


FAMILIES = {
    "random": Family("Obstacles in random cells.", ("height", "width", "density")),
    "walls": Family("Free-standing walls that branch and turn.", ("height", "width", "wall_density")),
    "maze": Family("Corridors between walls.", ("height", "width", "corridor", "loops")),
    "primal2": Family(
        "Mazes as in PRIMAL2 and POGEMA.",
        ("height", "width", "primal2_density", "primal2_components", "primal2_straight"),
    ),
    "room": Family("Rooms that are connected by doors.", ("height", "width", "room_size")),
    "warehouse": Family("Shelves between aisles.", ("height", "width", "corridor", "shelf_length")),
}
"""The families of `MapMixture`."""


def all_names(solvers: Sequence[str] = ()) -> dict[str, Any]:
    """Return the response to `names`, except for the folders; `solvers` are planners and policies of the user."""
    return {
        "maps": list(map_paths()),
        "scenarios": scenario_names(),
        "problems": list(problem_names()),
        "graphs": [*GENERATED, *guidance_names()],
        "families": [_described(name) for name in FAMILIES],
        "planners": [{"name": name, "options": default_options(kind)} for name, kind in PLANNERS.items()]
        + [{"name": name, "options": default_options(imported_object(name))} for name in solvers],
        "policies": [{"name": name, "action_model": model} for name, model in bundled_policies().items()],
    }


def _described(family: str) -> dict[str, Any]:
    """Return a family with its options, whose docstrings and defaults, or the middles of ranges, are `MapMixture`'s."""
    defaults = {field.name: _middle(field.default) for field in fields(MapMixture)}
    docs = {name: " ".join(text.split()) for name, text in field_docs(MapMixture).items()}
    options = [
        {
            "name": name,
            "type": type(defaults[name]).__name__,
            "default": defaults[name],
            "help": docs[name],
        }
        for name in FAMILIES[family].options
    ]
    return {"name": family, "summary": FAMILIES[family].summary, "options": options}


def _middle(value: Any) -> Any:
    """Return the middle of a range of two numbers, of their type; other values as they are."""
    is_range = isinstance(value, tuple) and len(value) == 2
    return type(value[0])((value[0] + value[1]) / 2) if is_range else value


def mixture_of(request: GenerateRequest) -> MapMixture:
    """Return the family and the options of a map to generate.

    Raises `ValueError` for an unknown family or option, or an invalid value, and `Refusal` for a large map.
    """
    if request.family not in FAMILIES:
        raise ValueError(f"family {request.family!r}: {expected_names(request.family, FAMILIES)}")
    known = FAMILIES[request.family].options
    for name in request.options:
        if name not in known:
            raise ValueError(f"option {name!r}: {request.family} has the options {', '.join(known)}")
    check_shape(request.options.get("height", 1), request.options.get("width", 1))
    options: dict[str, Any] = request.options
    return MapMixture(maps=(request.family,), **options)


def graph(request: GraphRequest) -> dict[str, Any]:
    """Return the weights of a guidance graph for a map; raises `ValueError` for an unknown name or another map."""
    names = [*GENERATED, *guidance_names()]
    if request.name not in names:
        raise ValueError(f"graph {request.name!r}: {expected_names(request.name, names)}")
    return {"weights": weights_text(guidance_graph(request.name, grid_of(request.map, "map")))}


def opened(request: OpenRequest, folders: Folders) -> dict[str, Any]:
    """Return the name and the text of a file, or of several for a problem.

    Raises `Refusal` for another combination of members, `ValueError` for an unknown name, and as `Folders.read`.
    """
    match request:
        case OpenRequest(path=str(path), map=None, scenario=None, problem=None):
            return folders.read(path)
        case OpenRequest(path=None, map=str(map), scenario=None, problem=None):
            return open_map(map)
        case OpenRequest(path=None, map=str(map), scenario=str(scenario), problem=None):
            return open_scenario(scenario, map)
        case OpenRequest(path=None, map=None, scenario=None, problem=str(problem)):
            return _open_problem(problem, folders)
        case _:
            raise Refusal(400, "expected path, map, scenario and map, or problem")


def open_map(name: str) -> dict[str, Any]:
    """Return the file of a bundled or downloaded map; raises `ValueError` for an unknown name."""
    files = map_paths()
    if name not in files:
        raise ValueError(f"map {name!r}: {expected_names(name, files)}")
    return {"name": f"{name}.map", "text": read_text(files[name])}


def open_scenario(name: str, map: str) -> dict[str, Any]:
    """Return the file of a bundled or downloaded scenario of a map; raises `ValueError` for an unknown name."""
    names = scenario_names().get(map, [])
    if name not in names:
        raise ValueError(f"scenario {name!r}: {expected_names(name, names) if names else f'map {map!r} has none'}")
    grid = load_map(map)
    return {"name": f"{name}.scen", "text": format_scenario(load_scenario(name, grid), grid)}


def _open_problem(problem: str, folders: Folders) -> dict[str, Any]:
    """Return the files of a problem by name, or by the path of its JSON file."""
    if problem in problem_names():
        texts = format_problem(load_problem(problem))
        name = next(iter(texts))
    else:
        file = folders.inside(problem)
        read_problem(file)
        name = file.name
        data = parse_object(read_text(file), file)
        others = [text_member(data, member, file) for member in FILE_MEMBERS.values()]
        texts = {name: read_text(file), **{other: read_text(file.parent / other) for other in others}}
    data = parse_object(texts[name], name)
    named: dict[str, str] = {kind: data[member] for kind, member in FILE_MEMBERS.items()}
    return {
        "name": name,
        "text": texts[name],
        **{kind: texts[file] for kind, file in named.items()},
        **{f"{kind}Name": file for kind, file in named.items()},
    }
