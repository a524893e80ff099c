"""Who is let in: the page in a browser that was given the token, and nobody else."""

from __future__ import annotations

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from onebend.studio.server import LARGEST_BODY
from tests.studio.conftest import HOME, PORT, TOKEN, own

PATHS = (
    "/", "/main.js", "/page.css", "/api/places", "/api/result?name=beam", "/api/film?name=beam", "/api/job",
    "/api/beam?name=beam", "/api/check.png?name=beam", "/api/work/check", "/api/work/loop",
    "/api/record", "/api/record/sources", "/api/record/picture?n=1",
)  # fmt: skip
CHANGES = ("/api/stop", "/api/record/start", "/api/record/begin", "/api/record/stop")
EVERYWHERE = [*PATHS, "/nowhere", "/?token=", "/?token=another", f"/?token={TOKEN}&token=x", f"/main.js?token={TOKEN}"]


@pytest.mark.parametrize("path", EVERYWHERE)
def test_without_the_token_there_is_nothing(stranger: TestClient, path: str) -> None:
    answer = stranger.get(path)
    assert answer.status_code == 403
    assert "set-cookie" not in answer.headers
    assert "onebend studio" in answer.text


@pytest.mark.parametrize("path", PATHS)
def test_with_it_there_is(client: TestClient, path: str) -> None:
    assert client.get(path).status_code in (200, 422)


def test_the_token_becomes_a_cookie_that_no_script_and_no_other_site_has(stranger: TestClient) -> None:
    answer = stranger.get("/", params={"token": TOKEN})
    assert answer.headers["location"] == "/"
    cookie = answer.headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    assert TOKEN not in cookie


@pytest.mark.parametrize(
    "host", ["evil.example", f"evil.example:{PORT}", "127.0.0.1", f"127.0.0.1:{PORT + 1}", "", "[::1]"]
)
def test_a_name_that_leads_here_is_refused(client: TestClient, host: str) -> None:
    """DNS rebinding: the browser thinks that it asks its own site, and sends that site's name."""
    assert client.get("/api/places", headers={"host": host}).status_code == 403
    assert client.get("/", params={"token": TOKEN}, headers={"host": host}).status_code == 403


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", f"https://127.0.0.1:{PORT}", "http://127.0.0.1:1", ""]
)
def test_another_sites_page_may_neither_read_nor_write(client: TestClient, origin: str) -> None:
    for path in PATHS:
        assert client.get(path, headers={"origin": origin}).status_code == 403
    for path in CHANGES:
        assert client.post(path, json={}, headers={"origin": origin}).status_code == 403


@pytest.mark.parametrize("path", CHANGES)
def test_a_change_needs_the_token_and_an_origin(client: TestClient, stranger: TestClient, path: str) -> None:
    assert client.post(path, json={}).status_code == 403
    assert client.post(path, json={}, headers=own()).status_code in (200, 422)
    stranger.cookies.clear()
    assert stranger.post(path, json={}, headers=own()).status_code == 403


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_what_the_browser_says_of_its_source_counts(client: TestClient, site: str) -> None:
    assert client.get("/api/places", headers={"sec-fetch-site": site}).status_code == 403


SOCKET = f"ws://127.0.0.1:{PORT}/socket"


def refused(client: TestClient, headers: dict[str, str]) -> None:
    with pytest.raises(WebSocketDisconnect) as gone, client.websocket_connect(SOCKET, headers=headers):
        pass
    assert gone.value.code == 1008


def test_a_socket_opens_for_the_page_alone(client: TestClient, stranger: TestClient) -> None:
    for origin in ("http://evil.example", "null"):
        refused(client, {"origin": origin, "host": f"127.0.0.1:{PORT}"})
    refused(client, {"host": f"127.0.0.1:{PORT}"})
    refused(client, {"origin": "http://evil.example:80", "host": "evil.example:80"})
    with client.websocket_connect(SOCKET, headers=own(host=f"127.0.0.1:{PORT}")) as socket:
        assert socket.receive_json()["what"] == "hello"
    stranger.cookies.clear()
    refused(stranger, own(host=f"127.0.0.1:{PORT}"))


def test_a_wrong_cookie_is_none(stranger: TestClient) -> None:
    for value in ("", "x", TOKEN):
        stranger.cookies.set(f"onebend-studio-{PORT}", value)
        assert stranger.get("/api/places").status_code == 403


def test_a_body_that_says_nothing_of_its_length_is_cut(client: TestClient) -> None:
    endless = (b" " * 2**16 for _ in range(1000))
    assert client.post("/api/learn", content=endless, headers=own()).status_code == 413
    assert LARGEST_BODY < 2**20


def test_every_answer_is_bound_to_the_page(client: TestClient) -> None:
    for path in (*PATHS, "/nowhere"):
        headers = client.get(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "frame-ancestors 'none'" in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert "access-control-allow-origin" not in headers


def test_the_home_of_the_tests_is_the_guards() -> None:
    assert HOME.endswith(str(PORT))
