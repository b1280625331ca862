"""The error that every reader of a file raises."""

from __future__ import annotations

LONGEST_MESSAGE = 500
"""Characters; a damaged file may put as many as it holds into the message of another package's error."""


class FormatError(ValueError):
    """Malformed input: one line that says where, and what was expected.

    The text reads `FILE:LINE:COLUMN: MESSAGE`; line and column count from 1 and are left out when zero. A message of
    more than `LONGEST_MESSAGE` characters is cut.
    """

    def __init__(self, file: object, message: str, line: int = 0, column: int = 0) -> None:
        """Join the place and the message."""
        place = ":".join([str(file), *(str(n) for n in (line, column) if n)])
        cut = message[:LONGEST_MESSAGE] + " ..." if len(message) > LONGEST_MESSAGE else message
        super().__init__(f"{place}: {cut}")
        self._arguments = str(file), message, line, column

    def __reduce__(self) -> tuple[type[FormatError], tuple[str, str, int, int]]:
        """Let it pass from one process to another, which calls it with the exception's text otherwise."""
        return type(self), self._arguments
