"""Text for files of other programs: without control characters, and without formulas of spreadsheets."""

from __future__ import annotations

import re

_CONTROL = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "'")


def printable(text: str) -> str:
    """Return the text with `?` for the characters that XML does not allow, or discourages."""
    return _CONTROL.sub("?", text)


def to_cell(text: str) -> str:
    """Return the text for a cell of CSV, after an apostrophe if a spreadsheet would evaluate it as a formula."""
    return f"'{text}" if text.startswith(_FORMULA) else text


def from_cell(cell: str) -> str:
    """Return the text of a cell that `to_cell` has written."""
    return cell[1:] if cell.startswith("'") else cell
