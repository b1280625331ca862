"""The documentation: its programs run, and its site is built without a network and loads nothing from one.

All blocks of a page run in order, in one folder that is empty at first: `python` in one namespace; commands of
`mapf-pz` in tutorials and how-to guides; a block with `title="NAME"` is written to that file. A comment
`<!-- not run: WHY -->` just above a block excludes it. Commands run as the reader sees them, but for no longer than
`BUDGETS` allows.
"""

import dataclasses
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from html.parser import HTMLParser
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest

from mapf_pz.commands.main import COMMANDS, main
from mapf_pz.simulator.config import EnvConfig

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
GUIDES = [page for folder in ("tutorials", "how-to") for page in sorted((DOCS / folder).glob("*.md"))]

FENCE = re.compile(
    r"^(?P<mark><!-- not run: [^\n]+ -->\n)?```(?P<language>\w+)(?P<rest>[^\n]*)\n(?P<code>.*?)^```$", re.M | re.S
)
TITLE = re.compile(r'title="([\w.-]+)"')
NEEDS_TORCH = re.compile(r"mapf_pz\.rl|mapf-pz train|--policy (mappo|ippo|central)")
TRAINS = re.compile(r"mapf-pz train|\btrain\(")
BUDGETS = {
    "--agent-steps": (8, 5_000),
    "--validation-interval": (8, 5_000),
    "--episodes": (2, 4),
    "--minutes": (4, 0.03),
}
"""Options that say only how much a command computes: by what their values are divided, and the most that is run."""
SMALL = {"--num-envs": "8", "--validation-episodes": "8"}
"""Options that are added to commands that start a training."""


def within_budget(words):
    """Return a command's words with smaller numbers for the options in `BUDGETS`, and those of `SMALL`."""
    names = [None, *words[:-1]]
    shorter = [
        f"{min(float(word) / BUDGETS[name][0], BUDGETS[name][1]):g}" if name in BUDGETS else word
        for name, word in zip(names, words, strict=True)
    ]
    starts = words[0] == "train" and words[1] != "resume"
    return shorter + [word for option in SMALL.items() if starts and option[0] not in words for word in option]


@dataclass(frozen=True)
class Block:
    """A block of code."""

    page: Path
    line: int
    language: str
    code: str
    title: str | None

    def run(self, namespace, folder):
        if self.title is not None:
            (folder / self.title).write_text(self.code, "utf-8")
        elif self.language == "python":
            # Empty lines before it, so that a traceback shows the page's line.
            exec(compile("\n" * self.line + self.code, self.page, "exec"), namespace)
        else:
            # In this process, where torch is loaded once.
            for command in self.code.replace("\\\n", " ").splitlines():
                program, *words = shlex.split(command, comments=True)
                assert program == "mapf-pz", f"{self.page.name}:{self.line + 1}: expected mapf-pz or a mark"
                assert main(within_budget(words)) == 0, f"{self.page.name}:{self.line + 1}: {command}"


def blocks(page):
    """Return the blocks of a page that are run."""
    text = page.read_text("utf-8")
    found = []
    for fence in FENCE.finditer(text):
        language, title = fence["language"], TITLE.search(fence["rest"])
        runs = title is not None or language == "python" or (language == "sh" and page in GUIDES)
        if runs and fence["mark"] is None:
            line = text[: fence.start("code")].count("\n")
            found.append(Block(page, line, language, fence["code"], title and title[1]))
    return found


PAGES = {str(page.relative_to(DOCS)): found for page in sorted(DOCS.rglob("*.md")) if (found := blocks(page))}
PAGES["README.md"] = blocks(ROOT / "README.md")


def code_of(name):
    return "".join(block.code for block in PAGES[name])


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if TRAINS.search(code_of(name)) else []) for name in PAGES]
)
def test_page(name, request, tmp_path, monkeypatch):
    if NEEDS_TORCH.search(code_of(name)):
        pytest.importorskip("torchrl")
    if "from stable_baselines3" in code_of(name):
        pytest.importorskip("stable_baselines3")
    if TRAINS.search(code_of(name)):
        request.getfixturevalue("without_figures")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PATH", os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    files = {Path(block.title).stem for block in PAGES[name] if block.title}
    namespace = {"__name__": f"docs.{Path(name).stem}"}
    try:
        for block in PAGES[name]:
            block.run(namespace, tmp_path)
    finally:
        for module in files:
            sys.modules.pop(module, None)


def test_every_fence_is_understood():
    for page in DOCS.rglob("*.md"):
        text = page.read_text("utf-8")
        fences = re.findall(r"(?m)^ *```", text)
        assert len(fences) == 2 * len(FENCE.findall(text)), f"{page}: a fence that is not understood"


def test_pages_that_must_run_do():
    assert {"index.md", "reference/environment.md", "README.md"} <= PAGES.keys()
    assert {str(page.relative_to(DOCS)) for page in GUIDES} <= PAGES.keys()


def test_the_table_of_keywords_is_true():
    table = (DOCS / "reference" / "environment.md").read_text("utf-8").partition("## Arguments")[2]
    rows = re.findall(r"(?m)^\| `(\w+)` \| `([^`]+)`", table)
    fields = [(field.name, field.default) for field in dataclasses.fields(EnvConfig)]
    assert [(name, eval(default)) for name, default in rows] == fields


NO_NETWORK = """
import socket

def refuse(*_, **__):
    raise OSError("the site must be built without a network")

socket.socket.connect = socket.getaddrinfo = refuse
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built without a network."""
    pytest.importorskip("material")
    pytest.importorskip("mkdocstrings")
    folder = tmp_path_factory.mktemp("docs")
    (folder / "sitecustomize.py").write_text(NO_NETWORK)
    environment = os.environ | {"PYTHONPATH": str(folder), "NO_MKDOCS_2_WARNING": "1"}
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder / "site")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "site"


class Loads(HTMLParser):
    """Collects the addresses that a page makes a browser load: all but links to click on."""

    def __init__(self):
        super().__init__()
        self.addresses = []

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        relations = set((given.get("rel") or "").split())
        if tag != "link" or not relations & {"canonical", "prev", "next", "edit"}:
            names = ("src", "srcset", "data", "poster") + (("href",) if tag == "link" else ())
            self.addresses += [given[name] for name in names if given.get(name)]
        if given.get("style"):
            self.addresses += addresses_of_style(given["style"])


def addresses_of_style(text):
    return re.findall(r"""(?:url\(\s*['"]?|@import\s+['"])([^'")]+)""", text)


def is_elsewhere(address):
    return address.strip().startswith(("http:", "https:", "//"))


@pytest.mark.slow
def test_the_site_loads_nothing_from_elsewhere(site):
    pages, styles = sorted(site.rglob("*.html")), sorted(site.rglob("*.css"))
    assert len(pages) >= 25
    assert site / "editor.html" in pages
    assert {page.parent.name for page in pages} >= {"recordings", "how-to"}
    assert styles
    for page in pages:
        loads = Loads()
        text = page.read_text("utf-8")
        loads.feed(text)
        if page.name == "editor.html" or page.parent.name == "recordings":
            assert loads.addresses == []
        else:
            assert any(address.endswith(".css") for address in loads.addresses)
        inside = "".join(re.findall(r"(?s)<style[^>]*>(.*?)</style>", text))
        for address in loads.addresses + addresses_of_style(inside):
            assert not is_elsewhere(address), f"{page.relative_to(site)} loads {address}"
    for style in styles:
        for address in addresses_of_style(style.read_text("utf-8")):
            assert not is_elsewhere(address), f"{style.relative_to(site)} loads {address}"


@pytest.mark.slow
def test_search_works_in_pages_opened_as_files(site, new_page):
    page = new_page((site / "reference" / "rules.html").as_uri())
    page.set_default_timeout(600_000)  # ms, so that a page that waits in vain fails in the end
    page.click("[data-md-component=search-query]")
    page.get_by_text("Type to start searching").wait_for()
    page.locator("[data-md-component=search-query]").press_sequentially("vertex conflict")
    page.locator(".md-search-result__link").first.wait_for()
    links = page.locator(".md-search-result__link").evaluate_all("links => links.map((link) => link.href)")
    assert any(link.startswith((site / "glossary.html").as_uri()) for link in links)


PARTS = ("", "evaluation", "guidance", "instances", "planners", "render", "rl", "wrappers")


@pytest.mark.slow
@pytest.mark.parametrize("module", [f"mapf_pz.{part}".rstrip(".") for part in PARTS])
def test_the_site_has_all_public_names(site, module):
    if module == "mapf_pz.rl":
        pytest.importorskip("torchrl")
    text = "".join(page.read_text("utf-8") for page in (site / "reference" / "api").glob("*.html"))
    public = import_module(module)
    for name in public.__all__:
        if isinstance(getattr(public, name), ModuleType):
            continue
        homes = re.findall(rf'id="mapf_pz[\w.]*\.{name}"', text)
        assert homes, f"{module}.{name} is on no page of docs/reference/api/"


@pytest.mark.slow
def test_the_site_has_all_commands(site):
    text = (site / "reference" / "cli.html").read_text("utf-8")
    for name in COMMANDS:
        assert f'id="mapf-pz-{name}"' in text
    assert "--num-agents" in text


@pytest.mark.slow
def test_the_site_has_no_python_files(site):
    assert not list(site.rglob("*.py"))


def public_texts():
    """Return the texts that users read and copy, by file."""
    examples = (file for file in (ROOT / "examples").rglob("*") if file.suffix in (".py", ".ipynb", ".txt"))
    files = [ROOT / "README.md", *DOCS.rglob("*.md"), *examples]
    return {str(file.relative_to(ROOT)): file.read_text("utf-8") for file in files}


def test_pages_and_examples_use_public_names_only():
    for name, text in public_texts().items():
        assert not re.search(r"mapf_pz\._internal", text), name


def test_experiments_that_are_named_exist():
    files = [
        *ROOT.glob("*/Makefile"),
        ROOT / "Makefile",
        ROOT / "CONTRIBUTING.md",
        *(ROOT / "experiments").rglob("*.py"),
    ]
    texts = public_texts() | {str(file): file.read_text("utf-8") for file in files}
    named = {(name, module) for name, text in texts.items() for module in re.findall(r"-m (experiments[.\w]+)", text)}
    missing = {(name, module) for name, module in named if find_spec(module) is None}
    assert not missing
    assert len(named) > 40


def test_targets_that_are_named_exist():
    texts = public_texts() | {"CONTRIBUTING.md": (ROOT / "CONTRIBUTING.md").read_text("utf-8")}
    found = re.compile(r"(?m)(?:`|^)make (?:-f (\w+/Makefile) )?([a-z-]+)(?=`| [A-Z]+=| +#|$)")
    named = {(name, *match.groups()) for name, text in texts.items() for match in found.finditer(text)}
    for name, file, target in named:
        rules = (ROOT / (file or "Makefile")).read_text("utf-8")
        assert re.search(rf"(?m)^\.PHONY:.* {target}\b", rules), f"{name}: make {target}"
    assert len(named) > 15


def test_there_is_one_way_to_install():
    """In a copy of the repository, extras in brackets; an editable install hides the modules from type checkers."""
    for name, text in public_texts().items():
        for command in re.findall(r"pip install ([^\n`#]*)", text):
            assert not re.search(r"mapf-pz|(^| )(-e|--editable) ", command), f"{name}: {command}"
            if ".[" in command:
                assert re.match(r"-c constraints\.txt '\.\[\w+(,\w+)*\]'", command), f"{name}: {command}"


def test_the_check_in_the_readme_warns_of_nothing():
    (code,) = (block.code for block in PAGES["README.md"] if "parallel_api_test" in block.code)
    # Where pygame is installed, PettingZoo's tests import one of its games in a way that it warns of.
    quiet = ["-W", "error", "-W", "ignore:The old environment creation API:DeprecationWarning"]
    done = subprocess.run([sys.executable, *quiet, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert "arning" not in done.stdout + done.stderr
