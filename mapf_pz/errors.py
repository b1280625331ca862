"""`FormatError`: the error for malformed files; and the errors that users can cause."""

from __future__ import annotations

USER_ERRORS = (ValueError, TypeError, OSError, RuntimeError, MemoryError, ImportError)
"""Errors that a user can cause, which are reported in one line. Any other error is a bug and has a traceback."""
LONGEST_MESSAGE = 500
"""Maximum length in characters. Messages of other packages may contain the whole content of a damaged file."""


class FormatError(ValueError):
    """A file or text is malformed.

    The text of the error is one line, `FILE:LINE:COLUMN: MESSAGE`. Lines and columns are counted from 1, and omitted if
    they are 0. Messages are truncated to `LONGEST_MESSAGE` characters.
    """

    def __init__(self, file: object, message: str, line: int = 0, column: int = 0) -> None:
        """Create the error; `file` is the file, or a description of the input."""
        place = ":".join([str(file), *(str(n) for n in (line, column) if n)])
        cut = message[:LONGEST_MESSAGE] + " ..." if len(message) > LONGEST_MESSAGE else message
        super().__init__(f"{place}: {cut}")
        self._arguments = str(file), message, line, column

    def __reduce__(self) -> tuple[type[FormatError], tuple[str, str, int, int]]:
        """Support pickling, which by default would call the class with the text alone."""
        return type(self), self._arguments
