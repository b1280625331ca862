"""Responses of the server, with the headers that protect its page."""

from __future__ import annotations

import json
from collections.abc import Mapping

from starlette.responses import Response

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
"""The content security policy: the page is one file, which loads nothing and sends requests only to its server."""
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": POLICY,
    "Referrer-Policy": "no-referrer",  # the page's address contains the token
    "X-Content-Type-Options": "nosniff",
}
"""The headers of all responses."""


def json_response(members: Mapping[str, object], status: int = 200) -> Response:
    """Return a JSON object as a response; raises `ValueError` for numbers that JSON does not have."""
    return Response(json.dumps(members, allow_nan=False), status, HEADERS, "application/json")


def page_response(text: str) -> Response:
    """Return a web page as a response."""
    return Response(text, 200, HEADERS, "text/html")
