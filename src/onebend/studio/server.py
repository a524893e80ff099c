"""The studio's server, on this computer alone."""

from __future__ import annotations

import contextlib
import json
import logging
import secrets
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from functools import lru_cache
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
from onebend.studio.filming import asked_text, sources_data, wanted_recording
from onebend.studio.jobs import Jobs
from onebend.studio.places import MOST_STRANGERS, Guard, StudioFolder, learn_line, plain_word
from onebend.text_files import to_json

PAGE = Path(__file__).parent / "page"
HOST = "127.0.0.1"
LONGEST_MESSAGE, LARGEST_BODY = 64 * 1024, 256 * 1024  # bytes
FAULT = "Exception in ASGI application"  # as uvicorn logs an error that no handler has caught
_MOST_RECORDINGS = 50
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}


def application(places: StudioFolder, token: str, port: int) -> Guard:
    """The studio as an ASGI application for this token and port."""
    desk = Desk(places)
    asked = Asked(desk)

    @contextlib.asynccontextmanager
    async def life(_app: Starlette) -> AsyncIterator[None]:
        desk.begin()
        yield
        await desk.end()

    routes = [
        Route("/api/places", clean(asked.places)),
        Route("/api/result", clean(asked.result)),
        Route("/api/film", clean(asked.film)),
        Route("/api/job", clean(asked.job)),
        Route("/api/recordings/{what:str}", clean(asked.recordings), methods=["POST"]),
        Route("/api/check.png", clean(asked.check_picture)),
        Route("/api/beam", clean(asked.beam)),
        Route("/api/reach", clean(asked.reach), methods=["POST"]),
        Route("/api/work/{room:str}", clean(asked.work)),
        Route("/api/work/{room:str}/{what:str}", clean(asked.begin_work), methods=["POST"]),
        Route("/api/record", clean(asked.recording)),
        Route("/api/record/sources", clean(asked.sources)),
        Route("/api/record/picture", clean(asked.picture)),
        Route("/api/record/{what:str}", clean(asked.record), methods=["POST"]),
        Route("/api/learn", clean(asked.learn), methods=["POST"]),
        Route("/api/stop", clean(asked.stop), methods=["POST"]),
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


class Asked:
    """Handlers of HTTP requests."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk

    async def places(self, _request: Request) -> Response:
        found = await run_in_threadpool(self.desk.places.found)
        rows = [{"name": one.name, "kind": one.kind, "changed": one.changed, **one.about} for one in found]
        return _said({"folder": str(self.desk.places.root), "found": rows})

    async def result(self, request: Request) -> Response:
        name = _name(request)
        return _said(await _of_room("learned", "result_data", name, self.desk.places.result(name)))

    async def film(self, request: Request) -> Response:
        return _said(await _of_room("learned", "film_data", self.desk.places.result(_name(request))))

    async def job(self, _request: Request) -> Response:
        return _said({"job": self.desk.jobs.shown()})

    async def recordings(self, request: Request) -> Response:
        what, asked = request.path_params["what"], await _posted(request)
        found = await _of_room("recordings", "answer", self.desk.places, what, asked)
        if what == "new":
            self.desk.tell({"what": "places"})
        if what == "save" and "conflict" not in found:
            self.desk.tell({"what": "saved", "name": asked["name"], "version": found["version"]})
        return _said(found)

    async def check_picture(self, request: Request) -> Response:
        picture = await _of_room("recordings", "check_picture_of", self.desk.places, _name(request))
        return Response(picture, media_type="image/png")

    async def beam(self, request: Request) -> Response:
        name = _name(request)
        return _said(await _of_room("looping", "beam_data", name, self.desk.places.result(name)))

    async def reach(self, request: Request) -> Response:
        asked = await _posted(request)
        wanted = await _of_room("looping", "reach_asked", self.desk.places, asked)
        return _said(await self.desk.reach(*wanted))

    async def work(self, request: Request) -> Response:
        work = self._work(request)
        return _said({"job": work.shown(), "found": [] if work.job is None else work.job.found})

    async def begin_work(self, request: Request) -> Response:
        work, what, asked = self._work(request), request.path_params["what"], await _posted(request)
        if what == "stop":
            await work.stop()
        elif what == "start":
            await work.start(await _of_room(work.module, "wanted_work", self.desk.places, asked))
        elif what == "go":
            work.say(what)
        else:
            raise StudioError(f"work is started and stopped; there is no {what[:100]!r}")
        return _said({})

    def _work(self, request: Request) -> Jobs:
        room = request.path_params["room"]
        if room not in self.desk.works:
            raise StudioError(f"there is no work of the kind {room[:100]!r}")
        return self.desk.works[room]

    async def recording(self, _request: Request) -> Response:
        return _said({"recording": self.desk.recorder.shown()})

    async def sources(self, _request: Request) -> Response:
        await self.desk.load("onebend.live.specs")
        return _said(await run_in_threadpool(sources_data, self.desk.places))

    async def picture(self, request: Request) -> Response:
        number = request.query_params.get("n", "")
        picture = self.desk.recorder.picture(int(number) if number.isdecimal() and len(number) < 16 else 0)
        return Response(picture, media_type="image/jpeg")

    async def record(self, request: Request) -> Response:
        what, recorder = request.path_params["what"], self.desk.recorder
        if what == "start":
            asked = await _posted(request)
            await self.desk.load("onebend.recording.folder")
            wanted = await run_in_threadpool(wanted_recording, self.desk.places, asked)
            await recorder.start(wanted)
            return _said({"out": wanted["out"]})
        if what not in ("begin", "stop"):
            raise StudioError(f"a recording is started, begun and stopped; there is no {what[:100]}")
        (recorder.begin if what == "begin" else recorder.end_film)()
        return _said({})

    async def learn(self, request: Request) -> Response:
        asked = await _posted(request)
        recordings, validate = _names(asked, "recordings"), _names(asked, "validate")
        if not recordings:
            raise StudioError("choose a recording to learn from")
        for one in (*recordings, *validate):
            self.desk.places.recording(one)
        out = asked_text(asked, "out") or f"{Path(recordings[0]).name}-results"
        if self.desk.places.path(out) == self.desk.places.root:
            raise StudioError("results go to a folder of their own")
        replace = asked.get("replace") is True
        wanted = {"recordings": recordings, "validate": validate, "out": out, "replace": replace}
        command = learn_line(recordings, validate, plain_word(out), replace)
        await self.desk.jobs.start({**wanted, "folder": str(self.desk.places.root), "command": command})
        return _said({"out": out})

    async def stop(self, _request: Request) -> Response:
        await self.desk.jobs.stop()
        return _said({})


def clean(work: Callable[[Request], Awaitable[Response]]) -> Callable[[Request], Awaitable[Response]]:
    """`work` with errors in one sentence."""

    async def inside(request: Request) -> Response:
        try:
            return await work(request)
        except OnebendError as error:
            return _said({"error": str(error)}, 422)
        except ClientDisconnect:  # nobody is there to be answered
            return Response(status_code=400)

    return inside


def _said(data: Any, status: int = 200) -> Response:
    return Response(to_json(data, readable=False), status, media_type="application/json")


async def _of_room(room: str, function: str, *arguments: Any) -> Any:
    """Loads the room on first use, in the asking thread."""
    return await run_in_threadpool(lambda: getattr(import_module(f"onebend.studio.{room}"), function)(*arguments))


def _name(request: Request) -> str:
    return request.query_params.get("name", "")


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


def _names(asked: dict[str, Any], key: str) -> list[str]:
    found = asked.get(key, [])
    if not isinstance(found, list) or len(found) > _MOST_RECORDINGS or not all(isinstance(one, str) for one in found):
        raise StudioError(f"{key}: give names of recordings")
    return [plain_word(one) for one in found]


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
