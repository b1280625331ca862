"""The layout: folders, import rules, and how little an import does."""

import ast
import dataclasses
import os
import re
import subprocess
import sys
import tomllib
from collections import Counter
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

from mapf_pz.simulator.config import EnvConfig

ROOT = Path(__file__).parents[1]
TOP_FOLDERS = {"mapf_pz": ROOT / "mapf_pz", "mapf_pz.wrappers": ROOT / "wrappers", "mapf_pz.maps": ROOT / "maps"}

# A folder imports only itself and those before it.
ORDER = [
    "errors",
    "_internal",
    "instances",
    "guidance",
    "simulator",
    "render",
    "environment",
    "planners",
    "wrappers",
    "rl",
    "evaluation",
    "optimization",
    "editor",
    "commands",
    "__main__",
]


def find_modules():
    """Return the file of every module by name; the links to the top folders are not followed."""
    modules = {}
    for package, folder in TOP_FOLDERS.items():
        for path, subfolders, files in os.walk(folder):
            subfolders[:] = [name for name in subfolders if name != "__pycache__"]  # os.walk does not follow links
            for file in files:
                if file.endswith(".py"):
                    parts = (Path(path) / file).relative_to(folder).with_suffix("").parts
                    modules[".".join((package, *parts)).removesuffix(".__init__")] = Path(path) / file
    return modules


MODULES = find_modules()


@cache
def tree(name):
    """Return the syntax tree of a module."""
    return ast.parse(MODULES[name].read_text("utf-8"))


@cache
def imports(name):
    """Return what a module imports, anywhere in it: full names."""
    found = []
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: a relative import in line {node.lineno}"
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return found


def part(name):
    """Return the part of the package that a full name belongs to; None for another package's."""
    parts = name.split(".")
    return parts[1] if parts[0] == "mapf_pz" and len(parts) > 1 else None


def test_all_modules_are_found():
    assert {
        "mapf_pz",
        "mapf_pz.environment",
        "mapf_pz.simulator.kernels.step",
        "mapf_pz.wrappers",
        "mapf_pz.maps",
    } <= MODULES.keys()


def test_every_package_is_listed():
    setuptools = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"]
    packages = {name for name, file in MODULES.items() if file.name == "__init__.py"}
    assert set(setuptools["packages"]) == packages
    folders = {name: str(folder.relative_to(ROOT)) for name, folder in TOP_FOLDERS.items()}
    assert setuptools["package-dir"] == folders
    for name, folder in TOP_FOLDERS.items():
        link = ROOT / name.replace(".", "/")  # for type checkers
        if link.is_file():  # a clone without symbolic links: the file contains the target
            link = link.parent / link.read_text("utf-8").strip()
        assert link.resolve() == folder


def test_every_folder_of_modules_is_a_package():
    assert {file.parent / "__init__.py" for file in MODULES.values()} <= set(MODULES.values())


@pytest.mark.parametrize("name", sorted(MODULES.keys() - {"mapf_pz"}))  # `mapf_pz` itself loads all on first use
def test_imports_point_downward(name):
    own = part(name)
    if own == "maps":
        assert imports(name) == []
        return
    for imported in imports(name):
        target = part(imported)
        if target is not None:
            assert ORDER.index(target) <= ORDER.index(own), f"{name} imports {imported}"


@pytest.mark.parametrize("name", sorted(MODULES))
def test_forbidden_imports(name):
    own = part(name)
    for imported in imports(name):
        top = imported.split(".")[0]
        assert top not in ("wrappers", "maps"), f"{name} imports {imported}: say mapf_pz.{top}"
        assert imported != "mapf_pz", f"{name} imports the whole package"
        if own != "rl":
            assert top not in ("torch", "torchrl", "tensordict"), f"{name} imports {imported}"
            assert top != "pygame" or name == "mapf_pz.render.window", f"{name} imports {imported}"
        else:
            assert part(imported) not in ("environment", "wrappers"), f"{name} imports {imported}"


def run(code, **environment):
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env=os.environ | environment,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.strip()


def test_importing_the_package_loads_little():
    code = """
import sys, mapf_pz
heavy = {"torch", "torchrl", "tensordict", "pygame", "numba", "matplotlib", "PIL", "wrappers", "maps"}
own = {name for name in sys.modules if name.startswith("mapf_pz")}
print(sorted(heavy & sys.modules.keys()), sorted(own))
"""
    assert run(code) == "[] ['mapf_pz']"


def test_packages_are_loaded_when_they_are_used():
    code = """
import sys, mapf_pz
names = {"planners": "PIBT", "wrappers": "ContinuousActions", "instances": "load_map", "rl": "train",
         "evaluation": "rollout", "guidance": "GuidanceGraph", "render": "Recording", "simulator": "Simulator",
         "optimization": "__doc__"}
for package, name in names.items():
    assert package in dir(mapf_pz) and name in dir(getattr(mapf_pz, package)), package
print("torch" in sys.modules)
"""
    assert run(code) == "False"


def test_only_what_users_use_is_shown():
    for package in ("mapf_pz", "mapf_pz.environment", "mapf_pz.rl", "mapf_pz.simulator"):
        module = import_module(package)
        assert dir(module) == sorted(module.__all__)


def test_the_environment_needs_no_torch():
    code = """
import sys, mapf_pz
env = mapf_pz.parallel_env(render_mode="ansi")
env.reset(seed=0)
env.render()
print(sorted({"torch", "torchrl", "tensordict", "pygame", "matplotlib", "PIL"} & sys.modules.keys()))
"""
    assert run(code) == "[]"


def test_a_public_name_stays_what_it_is():
    """No module has the name of the function `mapf_pz.env`: Python would put it in the function's place."""
    code = """
import mapf_pz
for _ in range(2):
    assert mapf_pz.env(num_agents=2).possible_agents == ["agent_0", "agent_1"]
    assert mapf_pz.parallel_env(num_agents=2).possible_agents == ["agent_0", "agent_1"]
    assert all(hasattr(mapf_pz, name) for name in mapf_pz.__all__)
"""
    assert run(code) == ""


def test_another_process_finds_compiled_code():
    code = """
import mapf_pz, sys
from numba.core.dispatcher import Dispatcher
from mapf_pz._internal.jit import BatchKernel
env = mapf_pz.parallel_env(features=("time", "location"), channels=("view", "cost_to_go"))
env.reset(seed=0)
env.step(dict.fromkeys(env.agents, 0))
env.state()
env.metrics()
values = [v for name, m in list(sys.modules.items()) if name.startswith("mapf_pz.") for v in vars(m).values()]
compiled = [v for v in values if isinstance(v, Dispatcher)]
compiled += [k for v in values if isinstance(v, BatchKernel) for k in (v._serial, v._parallel)]
stats = [kernel.stats for kernel in set(compiled)]
print(sum(sum(s.cache_hits.values()) for s in stats), sum(sum(s.cache_misses.values()) for s in stats))
"""
    run(code)
    hits, misses = map(int, run(code).split())
    assert misses == 0
    assert hits > 8


def test_another_process_writes_nothing_into_the_cache(tmp_path):
    code = """
import numpy as np
from mapf_pz.instances import components
components(np.ones((3, 3), np.bool_))
"""
    listings = []
    for _ in range(2):
        run(code, NUMBA_CACHE_DIR=str(tmp_path))
        files = [file for file in tmp_path.rglob("*") if file.is_file()]
        listings.append({str(file): file.stat().st_mtime_ns for file in files})
    first, second = listings
    assert len(first) >= 1
    assert first == second


# Sizes. They are limits, not goals.

ENV_FIELDS = {field.name for field in dataclasses.fields(EnvConfig)}


def definitions(kind):
    """Return the definitions of a kind in all modules: module and node."""
    return [(name, node) for name in MODULES for node in ast.walk(tree(name)) if isinstance(node, kind)]


def length_of(name, node):
    """Return the number of lines of a function, without comments that have a line: to explain a step costs nothing."""
    lines = MODULES[name].read_text("utf-8").splitlines()[node.lineno - 1 : node.end_lineno]
    return sum(not line.strip().startswith("#") for line in lines)


def test_functions_are_short():
    lengths = {f"{name}.{node.name}": length_of(name, node) for name, node in definitions(ast.FunctionDef)}
    assert not {name: length for name, length in lengths.items() if length > 60}


def test_folders_are_small():
    folders = Counter(file.parent for file in MODULES.values())
    assert not {str(folder): count for folder, count in folders.items() if count > 20}


def test_every_folder_says_what_it_is_for_and_what_to_read_first():
    for name, file in MODULES.items():
        if file.name == "__init__.py" and name.count(".") == 1 and part(name) != "maps":
            text = ast.get_docstring(tree(name))
            first = re.search(r"Read\s+`([\w/.]+)`", text)
            assert first is not None, f"{name}: expected the file to read first"
            assert (file.parent / first[1]).is_file(), f"{name}: {first[1]}"


def test_the_page_about_the_architecture_names_what_there_is():
    text = (ROOT / "docs" / "explanation" / "architecture.md").read_text("utf-8")
    rows = list(re.findall(r"^\| `(\w+)` \|", text, re.M))
    assert rows == [name for name in ORDER if name not in ("errors", "__main__")]
    named = re.findall(r"`((?:\w+/)+\w*(?:\.(?:py|md))?)`", text)
    missing = [name for name in named if not ((ROOT / name).exists() or (ROOT / "mapf_pz" / name).exists())]
    assert missing == []
    assert len(named) > 40


def test_few_types_are_ignored():
    ignores = [
        name for name, file in MODULES.items() for _ in re.findall("(?:type|pyright): ?ignore", file.read_text("utf-8"))
    ]
    assert len(ignores) <= 6, ignores


def test_no_field_of_the_environment_has_a_second_default():
    for name, node in definitions(ast.ClassDef):
        if node.name == "EnvConfig":
            continue
        for member in node.body:
            if isinstance(member, ast.AnnAssign) and member.value is not None and member.target.id in ENV_FIELDS:
                default = ast.unparse(member.value)
                assert default == "None" or default.startswith("EnvConfig."), f"{name}.{node.name}.{member.target.id}"
