"""The instance editor: a local server whose page edits maps and scenarios, and runs solvers.

It imports everything but the commands. Read `server.py` first.
"""

from __future__ import annotations

from mapf_pz.editor.page import save_editor

__all__ = ["save_editor"]
