"""Extend the site: links out of docs/, the command-line reference, the editor, and recordings."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator
from contextlib import redirect_stdout
from importlib.util import find_spec
from pathlib import Path
from posixpath import dirname, join, normpath
from tempfile import TemporaryDirectory
from unittest.mock import patch

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from mapf_pz.commands.main import COMMANDS, main
from mapf_pz.editor.page import editor_page

LINK = re.compile(r"(?<!!)\[([^]]*)]\((\.\./[^)\s]*)\)")
COMMAND_REFERENCE = "<!-- command reference -->"
SAME_OPTIONS = {
    *("mappo", "ippo", "mappo-cardinal", "central-ppo", "central-ppo-8", "central-warehouse", "report"),
    *("lifelong", "lifelong-cardinal", "oneshot", "oneshot-cardinal"),
}
"""Presets of `mapf-pz train` with the same options as `quickstart`, which are not listed again."""


RECORDINGS_LIST = "<!-- recordings -->"
RECORDINGS = {
    "warehouse-oneshot": (
        "`oneshot+pibt`, 100 agents that turn, warehouse-10-20-10-2-1",
        "--policy oneshot+pibt --map warehouse-10-20-10-2-1 --num-agents 100 --max-steps 512",
    ),
    "warehouse-pibt": (
        "`pibt`, the same episode",
        "--policy pibt --map warehouse-10-20-10-2-1 --num-agents 100 --max-steps 512",
    ),
    "random-mappo": (
        "`mappo`, 12 agents that turn, random-16-16-20",
        "--policy mappo --map random-16-16-20 --num-agents 12 --max-steps 128",
    ),
    "lifelong": (
        "`lifelong-cardinal+pibt:temperature=0,patience=0`, 48 agents with new goals, random-24-24-20",
        "--policy lifelong-cardinal+pibt:temperature=0,patience=0 --map random-24-24-20 --num-agents 48 "
        "--on-target restart --action-model cardinal --max-steps 256",
    ),
}
"""Recordings by file name: a description, and the options of `mapf-pz render`."""


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the editor and, where policies can be loaded, recordings."""
    files.append(File.generated(config, "editor.html", content=editor_page()))
    for name, content in recordings():
        files.append(File.generated(config, f"recordings/{name}.html", content=content))
    return files


def recordings() -> Iterator[tuple[str, str]]:
    """Yield the name and the page of each recording; none without the extra `train`."""
    if find_spec("torchrl") is None:
        return
    with TemporaryDirectory() as folder:
        for name, (_, options) in RECORDINGS.items():
            file = Path(folder) / f"{name}.html"
            with redirect_stdout(io.StringIO()):
                status = main(["render", str(file), *options.split()])
            if status:
                raise PluginError(f"mapf-pz render {options} failed")
            yield name, file.read_text("utf-8")


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return the page with the command-line reference filled in, and with links out of docs/ made valid.

    Links to files of the repository become plain text, or links to the repository if `repo_url` is set.
    """
    folder = dirname(page.file.src_uri)

    def replace(link: re.Match[str]) -> str:
        text, target = link.groups()
        path = normpath(join(folder, target))
        if not path.startswith("../"):
            return link.group()
        return f"[{text}]({config.repo_url.rstrip('/')}/blob/HEAD/{path[3:]})" if config.repo_url else text

    if COMMAND_REFERENCE in markdown:
        markdown = markdown.replace(COMMAND_REFERENCE, "\n".join(command_reference()))
    if RECORDINGS_LIST in markdown and find_spec("torchrl") is not None:
        links = (f"- [{title}](recordings/{name}.html)" for name, (title, _) in RECORDINGS.items())
        markdown = markdown.replace(RECORDINGS_LIST, "\n".join(links))
    return LINK.sub(replace, markdown)


def command_reference() -> Iterator[str]:
    """Yield Markdown lines that document every command, its subcommands and their options."""
    for name in COMMANDS:
        if name == "train" and find_spec("torchrl") is None:
            yield f"## mapf-pz {name}\n\nNot listed: this site was built without the extra `train`.\n"
        else:
            yield from _section([name])


def _section(words: list[str]) -> Iterator[str]:
    usage, boxes = _parse(_help(words))
    yield f"{'#' * (len(words) + 1)} mapf-pz {' '.join(words)}\n"
    yield f"{usage}\n"
    subcommands: list[str] = []
    for title, intro, options in boxes:
        if title == "subcommands":
            subcommands = [name for name, _ in options if name not in SAME_OPTIONS]
            if same := [f"`{name}`" for name, _ in options if name in SAME_OPTIONS]:
                yield f"{', '.join(same)} have the options of `quickstart`, with other defaults.\n"
            continue
        rows = [row for row in options if row[0] != "-h, --help"]
        if not rows:
            continue
        if title.startswith("config"):
            part = title.removesuffix(" options").removeprefix("config").removeprefix(".") or "run"
            yield f"**{part}**{f': {intro}' if intro else ''}\n"
        yield "| option | description |\n| --- | --- |"
        yield from (f"| `{option}` | {_cell(text)} |" for option, text in rows)
        yield ""
    for name in subcommands:
        yield from _section([*words, name])


def _help(words: list[str]) -> str:
    output = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")  # tyro draws boxes by the stream's encoding
    with patch.dict(os.environ, COLUMNS="100", NO_COLOR="1"), redirect_stdout(output):
        try:
            status = main([*words, "--help"])
        except SystemExit as stop:
            status = stop.code
    if status:
        raise PluginError(f"mapf-pz {' '.join(words)} --help failed")
    output.seek(0)
    return output.read()


Box = tuple[str, str, list[tuple[str, str]]]
"""A box of the help text: its title, its introduction, and its options or subcommands with their descriptions."""


def _parse(text: str) -> tuple[str, list[Box]]:
    """Return the usage with the summary, and the boxes of a help text."""
    before, *rest = re.split(r"(?m)^╭─ (.+?) ─+╮$", text)
    usage, _, summary = before.partition("\n\n")
    usage = " ".join(usage.removeprefix("usage: ").split())
    boxes = [(title, *_rows(body)) for title, body in zip(rest[::2], rest[1::2], strict=True)]
    return f"```text\n{usage}\n```\n\n{' '.join(summary.split())}", boxes


def _rows(body: str) -> tuple[str, list[tuple[str, str]]]:
    lines = [line[2:-2].rstrip() for line in body.splitlines() if line.startswith("│")]
    rule = next((number for number, line in enumerate(lines) if line.startswith("───")), None)
    intro = "" if rule is None else " ".join(lines[:rule])
    rows: list[tuple[str, str]] = []
    of_subcommands = any(line.startswith("  • ") for line in lines)
    for line in lines if rule is None else lines[rule + 1 :]:
        if line.startswith("  • ") or (line and not of_subcommands and not line.startswith((" ", "("))):
            option, _, text = re.sub(r"^  • ", "", line).partition("  ")
            if line.startswith("-") or not rows or not rows[-1][0].endswith(","):
                rows.append((option.strip(), text.strip()))
            else:  # the rest of a long list of choices
                rows[-1] = (rows[-1][0] + option.strip(), text.strip())
        elif rows:
            option, text = rows[-1]
            space = "" if text.count("`") % 2 and text.endswith(",") else " "  # code that was wrapped
            rows[-1] = (option, f"{text}{space}{line.strip()}".strip())
    return intro, rows


def _cell(text: str) -> str:
    """Escape what would end a table's cell, except in code."""
    return "`".join(part if number % 2 else part.replace("|", r"\|") for number, part in enumerate(text.split("`")))
