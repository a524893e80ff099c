"""The studio's server, on this computer alone."""

from __future__ import annotations

import contextlib
import json
import logging
import secrets
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from functools import lru_cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute

from onebend.crash import tell
from onebend.errors import OnebendError, StudioError
from onebend.studio.desk import Desk, said_of
from onebend.studio.filming import RecordingJobs
from onebend.studio.guard import MOST_STRANGERS, Guard
from onebend.studio.jobs import Jobs
from onebend.studio.places import StudioFolder
from onebend.studio.words import Asked
from onebend.text_files import to_json

PAGE = Path(__file__).parent / "page"
HOST = "127.0.0.1"
LONGEST_MESSAGE, LARGEST_BODY = 64 * 1024, 256 * 1024  # bytes
FAULT = "Exception in ASGI application"  # as uvicorn logs an error that no handler has caught
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}


def application(places: StudioFolder, token: str, port: int) -> Guard:
    """The studio as an ASGI application for this token and port."""
    desk = Desk(places)

    @contextlib.asynccontextmanager
    async def life(_app: Starlette) -> AsyncIterator[None]:
        desk.begin()
        yield
        await desk.end()

    routes = [
        *(Route(f"/api/{path}", answered(partial(work, desk)), methods=["GET"]) for path, work in GETS.items()),
        *(Route(f"/api/{path}", answered(partial(work, desk)), methods=["POST"]) for path, work in POSTS.items()),
        WebSocketRoute("/socket", desk.serve),
        Route("/{name:path}", _page_file),
    ]
    return Guard(Starlette(routes=routes, lifespan=life), token, port)


@lru_cache
def page_files() -> dict[str, tuple[bytes, str]]:
    """Bytes and media type of each file, read at once: threads would wait for the mechanics to load."""
    return {one.name: (one.read_bytes(), _TYPES[one.suffix]) for one in sorted(PAGE.iterdir()) if one.suffix in _TYPES}


async def _page_file(request: Request) -> Response:
    found = page_files().get(request.path_params["name"] or "index.html")
    if found is None:
        return Response("There is no such file.\n", 404, media_type="text/plain")
    return Response(found[0], media_type=found[1])


# Answers to requests: functions of the desk, and of what is asked by the address or the body.

Data = dict[str, Any]
Work = Callable[[Desk, Asked], Awaitable[Any]]


async def _of_room(function: str, desk: Desk, asked: Asked) -> Any:
    """By a function of the folder and the request, loaded on first use, in a thread."""
    room, name = function.split(":")
    module = f"onebend.studio.{room}"
    return await run_in_threadpool(lambda: getattr(import_module(module), name)(desk.places, asked))


def of_room(function: str) -> Work:
    return partial(_of_room, function)


async def check_picture(desk: Desk, asked: Asked) -> Response:
    return Response(await _of_room("recordings:check_picture_of", desk, asked), media_type="image/png")


async def recordings(desk: Desk, asked: Asked) -> Data:
    what = asked["what"]
    if what not in ("read", "check", "save", "new", "frame"):
        raise StudioError(f"a recording is read, checked, saved and begun; there is no {what[:100]!r}")
    found: Data = await _of_room(f"recordings:{what}", desk, asked)
    if what == "new":
        desk.tell({"what": "places"})
    if what == "save" and "conflict" not in found:
        desk.tell({"what": "saved", "name": asked["name"], "version": found["version"]})
    return found


async def reach(desk: Desk, asked: Asked) -> Data:
    return await desk.reach(*await _of_room("bending:reach_asked", desk, asked))


async def work(desk: Desk, asked: Asked) -> Data:
    job = _work(desk, asked).job
    return {"job": job and job.shown(), "found": [] if job is None else job.found}


async def do_work(desk: Desk, asked: Asked) -> Data:
    jobs, room, what = _work(desk, asked), asked["room"], asked["what"]
    if what != "start":
        await jobs.do(what)
        return {}
    wanted = await _of_room(f"requests:{room}", desk, asked)
    await jobs.start({**wanted, "folder": str(desk.places.root)})
    return {"out": wanted["out"]} if "out" in wanted else {}


def _work(desk: Desk, asked: Asked) -> Jobs:
    if asked["room"] not in desk.works:
        raise StudioError(f"there is no work of the kind {asked['room'][:100]!r}")
    return desk.works[asked["room"]]


def done(**known: str) -> Work:
    """`do_work` of what is known of the room and the work."""
    return lambda desk, asked: do_work(desk, Asked(asked | known))


def shown(name: str, room: str) -> Work:
    """The work of a room, under this name."""

    async def found(desk: Desk, _asked: Asked) -> Data:
        return desk.shown(name, room)

    return found


async def picture(desk: Desk, asked: Asked) -> Response:
    number, filming = asked.get("n", ""), desk.works["record"]
    assert isinstance(filming, RecordingJobs)
    found = filming.picture(int(number) if number.isdecimal() and len(number) < 16 else 0)
    return Response(found, media_type="image/jpeg")


GETS: dict[str, Work] = {
    "places": of_room("places:places_data"),
    "result": of_room("learned:result_data"),
    "film": of_room("learned:film_data"),
    "beam": of_room("bending:beam_data"),
    "check.png": check_picture,
    "job": shown("job", "learn"),
    "work/{room:str}": work,
    "record": shown("recording", "record"),
    "record/sources": of_room("requests:sources_data"),
    "record/picture": picture,
}
POSTS: dict[str, Work] = {
    "recordings/{what:str}": recordings,
    "reach": reach,
    "work/{room:str}/{what:str}": do_work,
    "record/{what:str}": done(room="record"),
    "learn": done(room="learn", what="start"),
    "stop": done(room="learn", what="stop"),
}


def answered(work: Callable[[Asked], Awaitable[Any]]) -> Callable[[Request], Awaitable[Response]]:
    """`work` as JSON, and errors in one sentence."""

    async def inside(request: Request) -> Response:
        try:
            asked = await _posted(request) if request.method == "POST" else dict(request.query_params)
            found = await work(Asked(asked | request.path_params))
        except OnebendError as error:
            return _said({"error": str(error)}, 422)
        except OSError as error:
            return _said({"error": f"{error.filename or 'a file'}: {error.strerror or error}"}, 422)
        except ClientDisconnect:  # nobody is there to be answered
            return Response(status_code=400)
        return found if isinstance(found, Response) else _said(found)

    return inside


def _said(data: Any, status: int = 200) -> Response:
    return Response(to_json(data, readable=False), status, media_type="application/json")


async def _posted(request: Request) -> dict[str, Any]:
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > LARGEST_BODY:  # whatever its stated length
            raise HTTPException(413, f"At most {LARGEST_BODY} bytes are taken here.\n")
    try:
        data = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise StudioError("the page sent no JSON") from error
    if not isinstance(data, dict):
        raise StudioError("the page sent no JSON object")
    return data


class OneLine(logging.Handler):
    """What the server logs, in one line each, and the same not twice in a row; a fault goes to a file of its own."""

    _said = ""

    def emit(self, record: logging.LogRecord) -> None:
        error, said = record.exc_info and record.exc_info[1], record.getMessage().partition("\n")[0]
        if said == self._said:
            return
        self._said = said
        if isinstance(error, Exception) and said.startswith(FAULT):
            said_of(error)
        else:
            tell(said)


def opened_socket(port: int) -> socket.socket:
    """Local; port 0: any. Raises `StudioError` if the port is taken."""
    found = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        found.bind((HOST, port))
    except OSError as error:
        found.close()
        raise StudioError(
            f"port {port} cannot be had ({error.strerror}). Take another --port, or leave it out"
        ) from error
    return found


def serve(folder: Path, *, port: int = 0, ready: Callable[[str], None]) -> None:
    """Serves until interrupted; `ready` gets the address with its token. Raises `StudioError`: no such folder, or the
    port is taken."""
    import uvicorn  # here: tests do without
    from uvicorn.protocols.http.auto import AutoHTTPProtocol

    places = StudioFolder.of(folder)
    listening = opened_socket(port)
    number, token = listening.getsockname()[1], secrets.token_urlsafe(24)
    guard = application(places, token, number)

    class Protocol(AutoHTTPProtocol):  # type: ignore[misc,valid-type]
        def connection_made(self, transport: Any) -> None:
            guard.strangers.came(transport)
            super().connection_made(transport)

    class Server(uvicorn.Server):
        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets=sockets)
            ready(f"http://{HOST}:{number}/?token={token}")

    config = uvicorn.Config(
        guard,
        http=Protocol,
        backlog=MOST_STRANGERS // 2,  # that many are taken at once, up to four times before the oldest of them end
        log_config=None,
        access_log=False,
        ws="websockets-sansio",
        ws_max_size=LONGEST_MESSAGE,
        lifespan="on",
        server_header=False,
        timeout_graceful_shutdown=2,
    )
    for name in ("uvicorn", "asyncio"):
        log = logging.getLogger(name)
        log.handlers, log.propagate = [OneLine()], False
        log.setLevel(logging.WARNING)
    with contextlib.suppress(KeyboardInterrupt):  # the way to end it
        Server(config).run(sockets=[listening])
