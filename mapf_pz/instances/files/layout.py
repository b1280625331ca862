"""Maps in the JSON files of guidance graph optimization (GGO): rows of characters, `@` and `T` for obstacles.

In warehouses, `w` are workstations, `e` endpoints, and `.` the other free cells. Source:
github.com/lunjohnzhang/ggo_public.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from reprlib import repr as shortened

import numpy as np

from mapf_pz._internal.arrays import Bools
from mapf_pz._internal.json import JsonObject, list_member
from mapf_pz.errors import FormatError

WORKSTATION, ENDPOINT = "w", "e"
PASSABLE = f".{WORKSTATION}{ENDPOINT}"
"""Characters of free cells."""
BLOCKED = "@T"
"""Characters of obstacles."""


def layout_rows(data: JsonObject, origin: str | Path) -> list[str]:
    """Return the rows of the member `layout`.

    Raises `FormatError` unless it is a list of text of one length, 1 or more, of the characters `PASSABLE` and
    `BLOCKED`.
    """
    rows = list_member(data, "layout", origin, least=1)
    allowed = re.compile(f"[{PASSABLE}{BLOCKED}]+")
    for number, row in enumerate(rows):
        if not isinstance(row, str) or not allowed.fullmatch(row):
            expected = f"expected row {number} of 'layout' to consist of {PASSABLE}{BLOCKED}"
            raise FormatError(origin, f"{expected}, got {shortened(row)}")
        if len(row) != len(rows[0]):
            raise FormatError(origin, f"expected {len(rows[0])} cells in row {number} of 'layout', got {len(row)}")
    return rows


def cells_of(rows: Sequence[str], characters: str) -> Bools:
    """Return which cells of a layout have one of the `characters`: (H, W)."""
    cells = np.frombuffer("".join(rows).encode(), np.uint8).reshape(len(rows), -1)
    return np.isin(cells, list(characters.encode()))
