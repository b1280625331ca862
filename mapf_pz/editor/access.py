"""Access to the server: only for its own page, which knows the token, from this machine."""

from __future__ import annotations

from hmac import compare_digest

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from mapf_pz.editor.responses import json_response

HOSTS = ("127.0.0.1", "localhost")
"""The names under which a browser on this machine reaches the server."""


class Access:
    """ASGI middleware that refuses requests without the token, to another host, or from the page of another origin.

    The host is checked because the page of another site can reach this machine under a name of that site (DNS
    rebinding).
    """

    def __init__(self, app: ASGIApp, token: str, port: int) -> None:
        """Protect `app`, which is served at `port` of this machine, by a token."""
        self._app = app
        self._token = token.encode()
        self._hosts = [f"{host}:{port}" for host in HOSTS]
        self._origins = [f"http://{host}" for host in self._hosts]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it with the status 403; connections other than HTTP are ignored."""
        if scope["type"] != "http":
            return
        refusal = self._refusal(Request(scope))
        app = self._app if refusal is None else json_response({"error": refusal}, 403)
        await app(scope, receive, send)

    def _refusal(self, request: Request) -> str | None:
        """Return why a request is refused, or None."""
        headers = request.headers
        if headers.getlist("host") not in [[host] for host in self._hosts]:
            return f"expected the host {' or '.join(self._hosts)}"
        if not set(headers.getlist("origin")) <= set(self._origins):
            return f"expected the origin {' or '.join(self._origins)}"
        given = request.query_params.get("token", "") if request.method == "GET" else headers.get("x-token", "")
        if not compare_digest(given.encode(), self._token):
            return "wrong token: expected the address that mapf-pz edit printed"
        return None
