"""The server: its page, and the functions that the page calls."""

from __future__ import annotations

import secrets
import socket
from collections.abc import Callable, Sequence
from hmac import compare_digest
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.requests import Request as HttpRequest
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from mapf_pz._internal.interrupts import interruptible
from mapf_pz.editor import requests
from mapf_pz.editor.catalog import all_names, graph, mixture_of, opened
from mapf_pz.editor.folders import Folders
from mapf_pz.editor.instances import graph_of, instance_of
from mapf_pz.editor.page import editor_page
from mapf_pz.editor.requests import Refusal, parse_request
from mapf_pz.editor.responses import json_response, page_response
from mapf_pz.editor.run import Runs, start_fork_server
from mapf_pz.editor.task import Task
from mapf_pz.evaluation.policies import PlannerFactory, TrainedFactory, bundled_policies, policy_factory
from mapf_pz.evaluation.solver import solver_of
from mapf_pz.guidance.library import is_guidance_file
from mapf_pz.instances import Delays
from mapf_pz.planners.named import own_code
from mapf_pz.rl.policies.folder import FILES, policy_folder
from mapf_pz.rl.policies.hub import is_address

HOST = "127.0.0.1"
"""The address of the server, which only this machine can reach."""
HOSTS = (HOST, "localhost")
"""The names under which a browser on this machine reaches the server."""
MAX_BODY_BYTES = 64 * 2**20
"""Maximum size of a request's body."""
BAD_INPUT = (ValueError, OSError, ImportError, MemoryError)
"""Errors that a request can cause. Any other error is a bug."""


def serve(
    folders: Folders, start: dict[str, Any], port: int, on_start: Callable[[str], object], solvers: Sequence[str] = ()
) -> None:
    """Serve the page until Ctrl-C or SIGTERM.

    Args:
        folders: the folders that the page may read and write.
        start: the files that the page opens, as in `create_app`.
        port: the port; 0: a free one.
        on_start: is called with the address of the page, which contains the token, once it can be opened.
        solvers: names of planners and policies of the user, `package.module:Class`, that the page may run.

    Raises `OSError` if the port is not available.
    """
    token, runs = secrets.token_urlsafe(32), Runs()
    with socket.create_server((HOST, port)) as listening:
        start_fork_server()  # not before, since a process that ends waits until this one has loaded its modules
        port = listening.getsockname()[1]
        config = uvicorn.Config(
            create_app(Editor(folders, runs, solvers), token, port, start),
            log_config=None,
            log_level="warning",
            access_log=False,
            server_header=False,
            proxy_headers=False,
            lifespan="off",
            ws="none",
            timeout_graceful_shutdown=1,
        )
        on_start(f"http://{HOST}:{port}/?token={token}")
        try:
            with interruptible():
                uvicorn.Server(config).run(sockets=[listening])
        except KeyboardInterrupt:  # how the server ends
            pass
        finally:
            runs.close()


class Editor:
    """The functions that the page calls by name. They block, so they run in threads."""

    def __init__(self, folders: Folders, runs: Runs, solvers: Sequence[str] = ()) -> None:
        """Create the functions, which read and write only in `folders`, and import only `solvers`: see `serve`."""
        self._folders = folders
        self._solvers = tuple(solvers)
        self._runs = runs
        self._functions: dict[str, tuple[type[requests.Request], Callable[[Any], dict[str, Any]]]] = {
            "names": (requests.NamesRequest, self.names),
            "list": (requests.ListRequest, lambda request: folders.entries(request.path)),
            "open": (requests.OpenRequest, lambda request: opened(request, folders)),
            "generate": (requests.GenerateRequest, self.generate),
            "cancel": (requests.CancelRequest, self.cancel),
            "graph": (requests.GraphRequest, graph),
            "save": (requests.SaveRequest, self.save),
            "solve": (requests.SolveRequest, self.solve),
            "progress": (requests.RunRequest, self.progress),
            "episode": (requests.EpisodeRequest, self.episode),
            "step": (requests.StepRequest, self.step),
            "stop": (requests.RunRequest, self.stop),
        }

    def call(self, name: str, body: bytes) -> Response:
        """Return the response to a request; raises `Refusal` for an unknown name or one of `BAD_INPUT`."""
        if name not in self._functions:
            raise Refusal(404, f"unknown function {name!r}: expected one of {', '.join(self._functions)}")
        kind, function = self._functions[name]
        try:
            return json_response(function(parse_request(kind, body)))
        except BAD_INPUT as error:
            raise Refusal(400, str(error) or type(error).__name__) from error

    def names(self, request: requests.NamesRequest) -> dict[str, Any]:
        """Return what is available by name, and the folders."""
        return all_names(self._solvers) | {"folders": [str(path) for path in self._folders.paths]}

    def generate(self, request: requests.GenerateRequest) -> dict[str, Any]:
        """Return a generated map."""
        return self._runs.generation.run(mixture_of(request), request.seed)

    def cancel(self, request: requests.CancelRequest) -> dict[str, Any]:
        """End the generation of a map."""
        self._runs.generation.stop()
        return {}

    def save(self, request: requests.SaveRequest) -> dict[str, Any]:
        """Write a file."""
        return self._folders.save(request.path, request.text, request.overwrite)

    def solve(self, request: requests.SolveRequest) -> dict[str, Any]:
        """Start a run, after checking the instance and the names of the solvers."""
        instance = instance_of(request.instance, request.lifelong)
        weights = request.instance.weights
        graph = None if weights is None else graph_of(weights, instance.grid)
        delays = None if request.delays is None else _delays_of(request.delays)
        tasks: list[Task] = []
        for solver in request.solvers:
            self._check_solver(solver, request.lifelong)
            limits = (request.time_limit, request.max_steps, request.seed)
            tasks.append(Task(instance, solver, request.lifelong, *limits, graph, delays))
        return {"run": self._runs.start(tasks)}

    def _check_solver(self, solver: str, lifelong: bool) -> None:
        """Raise `ValueError` for an unknown name or option; `Refusal` for files outside the folders, and other code."""
        if (code := own_code(solver)) is not None and code not in self._solvers:
            raise Refusal(403, f"{code}: expected code that the editor was started with, as in --solver {code}")
        if not lifelong:
            solver_of(solver)
        factory = policy_factory(solver)
        if isinstance(factory, TrainedFactory) and factory.name not in bundled_policies():
            self._check_run(factory.name)
        if isinstance(factory, PlannerFactory) and is_guidance_file(factory.edge_weights):
            self._folders.inside(factory.edge_weights)

    def _check_run(self, name: str) -> None:
        """Raise `Refusal` unless this is a training run, all of whose files are inside the folders."""
        if is_address(name):  # loading it would contact the network
            raise Refusal(403, f"{name}: expected a planner, a policy of the package, or a run inside the folders")
        self._folders.inside(name)
        for file in FILES:
            self._folders.inside(policy_folder(name) / file)

    def progress(self, request: requests.RunRequest) -> dict[str, Any]:
        """Return the progress of the solvers."""
        return {"solvers": [solver.progress() for solver in self._runs.solvers(request.run)]}

    def episode(self, request: requests.EpisodeRequest) -> dict[str, Any]:
        """Return the episode of a solver."""
        return self._runs.solver(request.run, request.solver).episode()

    def step(self, request: requests.StepRequest) -> dict[str, Any]:
        """Resume the episode of a solver in a new run."""
        given = (request.start, request.actions, request.steps)
        return {"run": self._runs.resume(request.run, request.solver, *given)}

    def stop(self, request: requests.RunRequest) -> dict[str, Any]:
        """End the processes of a run."""
        self._runs.stop(request.run)
        return {}


def _delays_of(text: str) -> Delays:
    """Return the delays that a text states; raises `ValueError` with the name of the member if it is malformed."""
    try:
        return Delays.from_text(text)
    except ValueError as error:
        raise ValueError(f"delays {text!r}: {error}") from None


def create_app(editor: Editor, token: str, port: int, start: dict[str, Any]) -> Starlette:
    """Return the application of the server.

    Args:
        editor: the functions that the page calls.
        token: the token that requests must contain.
        port: the port of this machine at which it is served.
        start: the files with which the page starts: `map` and `scenario`, each None or its `name` and `text`.
    """

    def page(request: HttpRequest) -> Response:
        return page_response(editor_page({"token": token, "start": start}))

    async def call(request: HttpRequest) -> Response:
        return await run_in_threadpool(editor.call, request.path_params["name"], await _body(request))

    return Starlette(
        routes=[Route("/", page), Route("/api/{name}", call, methods=["POST"])],
        middleware=[Middleware(Access, token=token, port=port)],
        exception_handlers={Refusal: _refused, HTTPException: _not_found, Exception: _failed},
    )


async def _body(request: HttpRequest) -> bytes:
    """Return the body of a request; raises `Refusal` if it is too large, whatever length is stated."""
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > MAX_BODY_BYTES:
            raise Refusal(413, f"expected a request of at most {MAX_BODY_BYTES} bytes")
    return bytes(body)


def _refused(request: HttpRequest, error: Exception) -> Response:
    status, members = (error.status, error.members) if isinstance(error, Refusal) else (400, {})
    return json_response({"error": " ".join(str(error).split()), **members}, status)


def _not_found(request: HttpRequest, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 404
    return json_response({"error": f"{request.method} {request.url.path}: not found"}, status)


def _failed(request: HttpRequest, error: Exception) -> Response:
    """Return the response to a bug, whose traceback the server prints."""
    return json_response({"error": f"internal error, see the terminal: {type(error).__name__}"}, 500)


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
