"""The page of the editor."""

from __future__ import annotations

import json
from typing import Any


def editor_page(data: dict[str, Any]) -> str:
    """Return the text of the page, which starts with `data`: the token, and the files to open."""
    return f"<!doctype html><title>Editor</title>{json.dumps(data)}"
