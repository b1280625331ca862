"""Check texts for the words in `docs/words.txt`: `python -m experiments.words`. Code, links and italics are ignored."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
WORDS = ROOT / "docs" / "words.txt"
TEXTS = ("*.md", "docs/**/*.md", "maps/*.md", "mapf_pz/rl/policies/*.md")
"""The files that are checked, as patterns below the repository's root."""
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


def main() -> int:
    """Print every word that is not used; return 1 if there are any."""
    words = load_words()
    files = sorted({file for pattern in TEXTS for file in ROOT.glob(pattern)})
    complaints = [
        f"{file.relative_to(ROOT)}:{line}: {word!r}: say {instead!r}"
        for file in files
        for line, word, instead in found_words(file.read_text("utf-8"), words)
    ]
    print("\n".join(complaints), end="\n" if complaints else "")
    return bool(complaints)


if __name__ == "__main__":
    sys.exit(main())
