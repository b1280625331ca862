"""Requests of anyone but the page are refused; malformed ones get one line."""

import json

import pytest
from pydantic import TypeAdapter

from mapf_pz.editor import requests
from mapf_pz.editor import server as editor_server
from tests.helpers.editor_server import TOKEN

GIVEN = {"X-Token": TOKEN}


def test_the_page(server):
    status, headers, text = server.request("GET", f"/?token={TOKEN}")
    assert status == 200
    assert text.startswith("<!doctype html>")
    assert TOKEN in text
    assert headers["Content-Type"].startswith("text/html")
    policy = headers["Content-Security-Policy"].split("; ")
    assert {"default-src 'none'", "connect-src 'self'", "img-src data: blob:", "frame-ancestors 'none'"} <= set(policy)
    assert headers["Cache-Control"] == "no-store"
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.parametrize("path", ["/", "/?token=", "/?token=the-toke", "/?token=the-tokens", "/?token=%C3%A4"])
def test_the_page_needs_the_token(server, path):
    status, _, text = server.request("GET", path)
    assert (status, "doctype" in text, TOKEN in text) == (403, False, False)


@pytest.mark.parametrize("headers", [{}, {"X-Token": ""}, {"X-Token": "wrong"}, {"X-Token": "\xe4"}])
def test_functions_need_the_token(server, headers):
    status, _, text = server.request("POST", "/api/names", "{}", headers)
    assert status == 403
    assert json.loads(text) == {"error": "wrong token: expected the address that mapf-pz edit printed"}
    assert server.request("POST", f"/api/names?token={TOKEN}", "{}", headers)[0] == 403


@pytest.mark.parametrize(
    "host", ["example.com", "127.0.0.1", "127.0.0.1:1", "example.com:{port}", "", "127.0.0.1:{port}.a"]
)
def test_another_host_is_refused(server, host):
    given = {"Host": host.format(port=server.port)}
    assert server.request("GET", f"/?token={TOKEN}", headers=given)[0] in (400, 403)
    assert server.request("POST", "/api/names", "{}", GIVEN | given)[0] in (400, 403)


def test_both_names_of_this_machine_are_hosts(server):
    for host in ("127.0.0.1", "localhost"):
        given = GIVEN | {"Host": f"{host}:{server.port}", "Origin": f"http://{host}:{server.port}"}
        assert server.request("POST", "/api/names", "{}", given)[0] == 200


@pytest.mark.parametrize("origin", ["null", "http://example.com", "https://127.0.0.1:{port}", "http://127.0.0.1"])
def test_another_origin_is_refused(server, origin):
    given = {"Origin": origin.format(port=server.port)}
    assert server.request("POST", "/api/names", "{}", GIVEN | given)[0] == 403
    assert server.request("GET", f"/?token={TOKEN}", headers=given)[0] == 403


@pytest.mark.parametrize("states_its_length", [True, False])
def test_a_large_body_is_refused(server, monkeypatch, states_its_length):
    monkeypatch.setattr(editor_server, "MAX_BODY_BYTES", 1000)
    body = json.dumps({"path": "a" * 2000}).encode()
    given = body if states_its_length else iter([body[:900], body[900:]])  # sent in chunks
    status, _, text = server.request("POST", "/api/list", given, GIVEN)
    assert (status, json.loads(text)) == (413, {"error": "expected a request of at most 1000 bytes"})


def test_unknown_addresses(server):
    status, error = server.refused("nothing")
    assert status == 404
    assert error.startswith("unknown function 'nothing': expected one of names, list, ")
    assert server.request("GET", f"/other?token={TOKEN}")[0] == 404
    assert server.request("GET", f"/api/names?token={TOKEN}")[0] == 405


@pytest.mark.parametrize(
    ("body", "error"),
    [
        ("", "Invalid JSON: EOF while parsing a value at line 1 column 0"),
        ("{", "Invalid JSON: EOF while parsing an object at line 1 column 1"),
        ("[]", "Input should be an object"),
        ("{}", "path: Field required"),
        ('{"path": 1}', "path: Input should be a valid string"),
        ('{"path": "a", "other": 1}', "other: Unexpected keyword argument"),
        (b'{"path": "\xff"}', "Invalid JSON: "),
        ("[" * 100_000, "Invalid JSON: recursion limit exceeded at line 1 column "),
    ],
)
def test_malformed_requests(server, body, error):
    status, answer = server.post("list", body)
    assert status == 400
    assert answer["error"].startswith(error)


LIMITS = {"maximum", "exclusiveMaximum", "le"}


def unbounded(schema, place):
    """Yield the places of numbers without a maximum in the JSON schema of a request."""
    if isinstance(schema, list):
        for part in schema:
            yield from unbounded(part, place)
    elif isinstance(schema, dict) and not schema.keys() & LIMITS:
        if schema.get("type") in ("integer", "number"):
            yield place
        for name, part in schema.items():
            yield from unbounded(part, f"{place}.{name}")


def test_every_number_of_a_request_is_bounded():
    kinds = [kind for kind in vars(requests).values() if isinstance(kind, type) and issubclass(kind, requests.Request)]
    assert len(kinds) > 10
    for kind in kinds:
        assert list(unbounded(TypeAdapter(kind).json_schema(), kind.__name__)) == []


LARGE = {"9223372036854775808": "less", "1e400": "less", "-1e400": "greater", "NaN": "greater"}


@pytest.mark.parametrize("number", LARGE)
@pytest.mark.parametrize(
    ("function", "body", "place"),
    [
        ("generate", '{"family": "maze", "options": {"corridor": %s}}', "options.corridor"),
        ("generate", '{"family": "room", "options": {"room_size": %s}}', "options.room_size"),
        ("generate", '{"family": "random", "options": {"density": %s}}', "options.density"),
    ],
)
def test_large_numbers_are_refused(server, function, body, place, number):
    status, answer = server.post(function, body % number)
    assert status == 400
    assert answer["error"].startswith(f"{place}: Input should be {LARGE[number]} than or equal to ")


def test_a_bug_is_one_line(server, monkeypatch):
    monkeypatch.setattr("mapf_pz.editor.server.all_names", lambda solvers: {}["maps"])
    assert server.refused("names") == (500, "internal error, see the terminal: KeyError")
