"""Check texts for the words in `docs/words.txt`: `python -m experiments.checks.words`.

Code, links and italics are ignored.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
WORDS = ROOT / "docs" / "words.txt"
TEXTS = ("*.md", "docs/**/*.md", "maps/*.md", "mapf_pz/rl/policies/bundled/*.md", "examples/notebooks/*.ipynb")
PROGRAMS = ("mapf_pz/**/*.py", "wrappers/*.py", "experiments/**/*.py", "examples/*.py")
"""The files that are checked, as patterns below the repository's root: texts, and programs' comments and docstrings."""
CODE = re.compile(r"^```.*?^```|`[^`\n]+`|\*\w[^*]*\*|\]\([^)]*\)|<!--.*?-->", re.M | re.S)


def load_words() -> dict[str, str]:
    """Return the words that are not used, with what to say instead."""
    lines = [line for line in WORDS.read_text("utf-8").splitlines() if line and not line.startswith("#")]
    return {word.strip(): instead.strip() for word, _, instead in (line.partition("=") for line in lines)}


def found_words(text: str, words: dict[str, str]) -> Iterator[tuple[int, str, str]]:
    """Yield line number, word and replacement of each word in a text that is not used."""
    parts = [re.escape(word).replace(r"\*", r"\w*").replace(r"\ ", r"\s+") for word in words]
    pattern = re.compile("|".join(rf"(\b{part}\b)" for part in parts), re.I)
    prose = CODE.sub(lambda code: re.sub(r"[^\n]", " ", code[0]), text)
    for match in pattern.finditer(prose):
        word = list(words)[(match.lastindex or 1) - 1]
        yield prose[: match.start()].count("\n") + 1, match[0], words[word]


def prose_of(file: Path) -> str:
    """Return a text, or the comments and docstrings of a program in their lines."""
    text = file.read_text("utf-8")
    if file.suffix != ".py":
        return text
    lines = [""] * (text.count("\n") + 2)
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            lines[token.start[0] - 1] += token.string
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            for k, line in enumerate(node.value.value.split("\n")):
                lines[node.lineno - 1 + k] += line
    return "\n".join(lines)


def main() -> int:
    """Print every word that is not used; return 1 if there are any."""
    words = load_words()
    files = sorted({file for pattern in (*TEXTS, *PROGRAMS) for file in ROOT.glob(pattern)})
    complaints = [
        f"{file.relative_to(ROOT)}:{line}: {word!r}: say {instead!r}"
        for file in files
        for line, word, instead in found_words(prose_of(file), words)
    ]
    print("\n".join(complaints), end="\n" if complaints else "")
    return bool(complaints)


if __name__ == "__main__":
    sys.exit(main())
