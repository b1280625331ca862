"""A server of the editor in a thread, and a client of it."""

import base64
import json
import socket
import threading
import time
import zlib
from http.client import HTTPConnection

import numpy as np
import uvicorn

from mapf_pz.editor.folders import Folders
from mapf_pz.editor.run import Runs
from mapf_pz.editor.server import Editor, create_app

TOKEN = "the-token"


class EditorServer:
    """A server on a free port that reads and writes in some folders."""

    def __init__(self, *folders, solvers=()):
        self.runs = Runs()
        self.editor = Editor(Folders(folders), self.runs, solvers)
        listening = socket.create_server(("127.0.0.1", 0))
        self.port = listening.getsockname()[1]
        app = create_app(self.editor, TOKEN, self.port, {"map": None, "scenario": None})
        config = uvicorn.Config(app, log_config=None, log_level="critical", lifespan="off", ws="none")
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, args=([listening],))
        self._thread.start()

    def close(self):
        self.runs.close()
        self._server.should_exit = True
        self._thread.join()

    def request(self, method, path, body=None, headers=None):
        """Return the status, the headers and the body of a response."""
        connection = HTTPConnection("127.0.0.1", self.port)
        try:
            connection.request(method, path, body, headers or {})
            response = connection.getresponse()
            return response.status, response.headers, response.read().decode()
        finally:
            connection.close()

    def post(self, name, body):
        """Return the status and the members of the response to a body."""
        status, _, text = self.request("POST", f"/api/{name}", body, {"X-Token": TOKEN})
        return status, json.loads(text)

    def call(self, function, /, **members):
        """Return the members of a response, whose status must be 200."""
        status, answer = self.post(function, json.dumps(members))
        assert status == 200, answer
        return answer

    def refused(self, function, /, **members):
        """Return the status and the error of a request that is refused."""
        status, answer = self.post(function, json.dumps(members))
        assert status != 200, answer
        assert "\n" not in answer["error"]
        return status, answer["error"]

    def finished(self, run):
        """Wait until all solvers of a run have ended, and return their progress."""
        while True:
            solvers = self.call("progress", run=run)["solvers"]
            if all(solver["state"] != "running" for solver in solvers):
                return solvers
            time.sleep(0.02)


def array(episode, name, dtype="<i4"):
    """Return an array of an episode, (N, T + 1); those of coordinates are stored as differences."""
    values = np.frombuffer(zlib.decompress(base64.b64decode(episode["arrays"][name])), dtype)
    return values.reshape(episode["agents"], -1)


def positions(episode):
    """Return the positions (T + 1, N, 2) of an episode."""
    return np.stack([array(episode, name).cumsum(axis=1).T for name in ("rows", "cols")], axis=2)
