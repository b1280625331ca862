"""What a release states in several files: Python versions, dependencies, the version, and what the workflows run."""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
PREFIX = "Programming Language :: Python :: "
VERSIONS = [re.sub(PREFIX, "", line) for line in PROJECT["project"]["classifiers"] if re.match(PREFIX + r"3\.\d", line)]
"""The Python versions of the classifiers."""


def read(file):
    return (ROOT / file).read_text("utf-8")


def jobs(workflow):
    return pytest.importorskip("yaml").safe_load(read(f".github/workflows/{workflow}"))["jobs"]


def commands(*found):
    return [step["run"] for job in found for step in job["steps"] if "run" in step]


def test_python_versions_have_no_gaps():
    minors = [int(version.removeprefix("3.")) for version in VERSIONS]
    assert minors == list(range(minors[0], minors[-1] + 1))


def test_the_lowest_python_is_the_same_everywhere():
    lowest = VERSIONS[0]
    assert PROJECT["project"]["requires-python"] == f">={lowest}"
    assert PROJECT["tool"]["ruff"]["target-version"] == "py" + lowest.replace(".", "")
    assert PROJECT["tool"]["basedpyright"]["pythonVersion"] == lowest
    for page in ("README.md", "docs/index.md"):
        assert re.findall(r"Python (3\.\d+) or newer", read(page)) == [lowest], page
    assert f"Python {lowest} to {VERSIONS[-1]}" in read("CHANGELOG.md")


def test_workflows_test_the_versions_of_the_classifiers():
    matrix = jobs("ci.yml")["test"]["strategy"]["matrix"]
    assert matrix["os"] == ["ubuntu-latest"]
    assert matrix["python"] == VERSIONS
    assert matrix["include"] == [{"os": "macos-latest", "python": VERSIONS[-1]}]
    for workflow in ("ci.yml", "docs.yml", "release.yml"):
        for name, job in jobs(workflow).items():
            for step in job["steps"]:
                if "setup-python" in step.get("uses", ""):
                    expected = {"test": "${{ matrix.python }}", "lowest": VERSIONS[0]}.get(name, VERSIONS[-1])
                    assert step["with"]["python-version"] == expected, (workflow, name)


def test_images_have_the_newest_python():
    assert re.findall(r"python:(3\.\d+)", read("Dockerfile")) == [VERSIONS[-1]]
    assert re.findall(r"python:(3\.\d+)", read(".devcontainer/devcontainer.json")) == [VERSIONS[-1]]


def test_workflows_run_the_commands_of_the_project():
    ci = jobs("ci.yml")
    lines = re.findall(r"(?m)^make .+", read(".ci/run"))
    locally = [f"make {target}" for line in lines for target in re.findall(r" ([a-z]+)", line)]
    assert sorted(locally) == ["make lint", "make test"]
    assert {*locally, "make wheel", "make -f tests/Makefile lowest", "make -f tests/Makefile slow"} <= set(
        commands(*ci.values())
    )
    assert {name for name, job in ci.items() if "needs" not in job} == {"environment"}
    assert all(job.get("needs") in (None, "environment") for job in ci.values())
    assert "parallel_api" in commands(ci["environment"])[-1]
    assert commands(*jobs("docs.yml").values()) == ["make docs"]


def test_only_a_tested_wheel_is_published():
    build, publish = jobs("release.yml").values()
    assert commands(build)[0] == "make wheel"
    assert "tests/environment/test_env.py" in re.search(r"(?m)^OUTSIDE_TESTS := (.*)", read("Makefile"))[1].split()
    assert publish["needs"] == "build"
    assert publish["permissions"] == {"id-token": "write"}
    assert publish["steps"][-1]["with"] == {"attestations": True}


def requirements_of(lines, extras):
    """Yield the requirements, with their extras, that apply on this machine."""
    for line in lines:
        requirement = Requirement(line)
        if requirement.marker is None or any(requirement.marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            yield requirement


def test_constraints_name_every_dependency():
    """Those of torch, which states their versions itself, are left to it."""
    pins = dict(line.split("==") for line in read("constraints.txt").splitlines())
    pins = {canonicalize_name(name): version for name, version in pins.items()}
    groups = PROJECT["project"]["dependencies"], *PROJECT["project"]["optional-dependencies"].values()
    direct = [line for group in groups for line in group if not line.startswith("mapf-pz[")]
    left = [*requirements_of(direct, ())]
    assert len(left) > 30
    done = set()
    while left:
        requirement = left.pop()
        name = canonicalize_name(requirement.name)
        assert name in pins, f"constraints.txt lacks {requirement}"
        assert requirement.specifier.contains(pins[name]), f"constraints.txt: {name}=={pins[name]}, but {requirement}"
        if name != "torch" and (name, *requirement.extras) not in done:
            done.add((name, *requirement.extras))
            try:
                left += requirements_of(requires(name) or (), requirement.extras)
            except PackageNotFoundError:  # the tests also run without some extras
                continue


def test_hooks_and_constraints_have_the_same_ruff():
    repos = pytest.importorskip("yaml").safe_load(read(".pre-commit-config.yaml"))["repos"]
    versions = {repo["repo"].rsplit("/")[-1]: repo["rev"] for repo in repos if repo["repo"] != "local"}
    assert f"ruff=={versions['ruff-pre-commit'].removeprefix('v')}\n" in read("constraints.txt")


def test_the_version_is_the_same_everywhere():
    version = PROJECT["project"]["version"]
    assert re.findall(r"(?m)^version: (.+)$", read("CITATION.cff")) == [version]
    assert f"\n## [{version}] - " in read("CHANGELOG.md")


def test_no_page_of_a_package_index_is_named_before_it_exists():
    """The first release removes this test: CONTRIBUTING.md."""
    files = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "mapf_pz").rglob("*.md")]
    files += (ROOT / "mapf_pz").rglob("*.py")
    assert len(files) > 200
    named = [str(file) for file in files if re.search(r"pypi\.org/project/mapf", file.read_text("utf-8"))]
    assert named == []
