"""Numbers in the documentation that no command generates: each section of them names the commit that they are from.

A section with a table of decimal numbers outside of the generated blocks has to say `commit 0123abc`, the commit that
measured or introduced the numbers, or `<!-- not measured -->` if the numbers are settings, definitions or computed.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
CARD = ROOT / "mapf_pz" / "rl" / "policies" / "bundled" / "README.md"
GENERATED = re.compile(r"<!-- table: .*?<!-- end of table -->", re.S)
NOT_MEASURED = "<!-- not measured -->"
_ROW = re.compile(r"(?m)^\|.*(?<![\w.])\d+\.\d+(?![\w.]).*$")
_COMMIT = re.compile(r"\bcommits? `?([0-9a-f]{7})\b")


def pages() -> list[Path]:
    """Return the pages that may have measured numbers."""
    return [ROOT / "README.md", CARD, *sorted((ROOT / "docs").rglob("*.md"))]


def sections(text: str) -> list[str]:
    """Return the sections of a page, each with its heading, without generated blocks."""
    return re.split(r"(?m)^(?=#+ )", GENERATED.sub("", text))


def without_origin(page: Path) -> Iterator[str]:
    """Yield a line for each section of a page with numbers of unknown origin, or with an unknown commit."""
    for section in sections(page.read_text("utf-8")):
        where = f"{page.relative_to(ROOT)}, {section.partition(chr(10))[0]!r}"
        commits = _COMMIT.findall(section)
        if _ROW.search(section) and not commits and NOT_MEASURED not in section:
            yield f"{where}: expected the commit of its numbers, or {NOT_MEASURED}"
        for commit in commits:
            if not _exists(commit):
                yield f"{where}: no commit {commit}"


def _exists(commit: str) -> bool:
    """Return whether there is such a commit; True where the history is not available."""
    if _git("rev-parse", "--is-shallow-repository").stdout.strip() != "false":
        return True
    return _git("cat-file", "-e", f"{commit}^{{commit}}").returncode == 0


def _git(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
