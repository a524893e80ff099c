"""State shared by all tabs: bent beams, running work, tabs. Every answer goes to all tabs; of fast drags the last
counts."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import sys
from collections.abc import Awaitable, Callable
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

from starlette.websockets import WebSocket, WebSocketDisconnect

import onebend
from onebend.crash import kept, tell, words
from onebend.errors import OnebendError, StudioError
from onebend.progress import end_now, own_process
from onebend.studio.filming import RecordingJobs
from onebend.studio.jobs import DriveJobs, Jobs
from onebend.studio.places import StudioFolder
from onebend.studio.words import Asked
from onebend.text_files import to_json

if TYPE_CHECKING:
    from onebend.control.reach_set import ReachMap
    from onebend.studio.bending import Bending


_MOST_WAITING = 64
_ENOUGH = 3  # waiting messages of a slow tab, beyond which it skips passing ones


class Client:
    count = itertools.count(1)

    def __init__(self, socket: WebSocket) -> None:
        self.socket, self.number = socket, next(self.count)
        self.waiting: asyncio.Queue[dict[str, Any]] = asyncio.Queue()

    def put(self, message: dict[str, Any], *, passing: bool = False) -> None:
        """A closed tab misses the message and asks again when it returns. `passing`: a newer one will replace it."""
        size = self.waiting.qsize()
        if size < _MOST_WAITING and not (passing and size > _ENOUGH):
            self.waiting.put_nowait(message)

    async def write(self) -> None:
        with contextlib.suppress(WebSocketDisconnect):
            while True:
                message = await self.waiting.get()
                try:
                    text = to_json(message, readable=False)
                except (ValueError, TypeError, RecursionError) as error:  # ours: the tab is told, and goes on
                    text = to_json({"what": "error", "text": said_of(error)}, readable=False)
                await self.socket.send_text(text)


_MOST_BEAMS = 8
_TURN = 5e-4  # s of the thread switch while mechanics load
_RESTS = 0.3  # s without a drag before the exact ellipse
WORKS: dict[str, type[Jobs]] = {"learn": Jobs, "check": Jobs, "loop": Jobs, "drive": DriveJobs, "record": RecordingJobs}


class Desk:
    """All methods run in the server's loop."""

    def __init__(self, places: StudioFolder) -> None:
        self.places = places
        self.clients: set[Client] = set()
        self.works = {room: kind(partial(self._changed, room)) for room, kind in WORKS.items()}
        self.beams: dict[str, Bending] = {}
        self.thread = ThreadPoolExecutor(1, "bend")  # beams are for one thread
        self.beside = own_process()
        self._wanted: dict[str, tuple[int, int, list[float]]] = {}  # by model: tab, number, goal
        self._drags = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self._busy: set[str] = set()  # models whose hand's edge is being computed
        self._moves: dict[str, int] = {}

    def begin(self) -> None:
        """Loads the mechanics while the page is already shown."""
        loaded = self.thread.submit(_load)
        loaded.add_done_callback(lambda _: self._load_beside())  # so that the first picture has both cores
        self._spawn(self._answer_drags())

    def _load_beside(self) -> None:
        with contextlib.suppress(RuntimeError):  # ended meanwhile
            self.beside.submit(_load)

    async def end(self) -> None:
        await asyncio.gather(*(one.end() for one in self.works.values()))
        for task in self._tasks:
            task.cancel()
        self.thread.shutdown(wait=False, cancel_futures=True)
        end_now(self.beside)

    async def serve(self, socket: WebSocket) -> None:
        """One tab from start to end."""
        await socket.accept()
        client = Client(socket)
        self.clients.add(client)
        writer = asyncio.create_task(self._watched(client.write(), self.tell))
        about = {"folder": str(self.places.root), **self.shown("job", "learn"), **self.shown("recording", "record")}
        client.put({"what": "hello", "you": client.number, **about})
        try:
            while (message := await socket.receive())["type"] == "websocket.receive":
                asked = request_of(message.get("text") or "")
                if asked is None:
                    with contextlib.suppress(WebSocketDisconnect):
                        await socket.close()
                    break
                await self._watched(self._answer(client, **asked), client.put)
        finally:
            self.clients.discard(client)
            writer.cancel()

    async def _answer(self, client: Client, do: Any, model: str, n: int, goal: list[float], settings: Any) -> None:
        if do == "open":
            await self._open(client, model)
        elif do == "drag":
            self._wanted[model] = (client.number, n, goal)
            self._drags.set()
        elif do == "set":
            await self._set(model, settings)

    async def _watched(self, work: Awaitable[None], put: Callable[[dict[str, Any]], None]) -> None:
        """Reports any failure of the work."""
        try:
            await work
        except Exception as error:
            put({"what": "error", "text": said_of(error)})

    async def _in_thread(self, work: Callable[[], Any]) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self.thread, work)

    async def _open(self, client: Client, model: str) -> None:
        if model not in self.beams:
            folder = self.places.result(model)
            bending = await self._in_thread(partial(_bend, "bending_of", model, folder))
            while len(self.beams) >= _MOST_BEAMS:
                self.forget(next(iter(self.beams)))
            self.beams.setdefault(model, bending)
            self._spawn(self._map(model))
        await self._show(model, lambda: None, (client,))

    async def _set(self, model: str, settings: Asked) -> None:
        bending = self._beam(model)
        await self._show(model, partial(bending.change, settings), tuple(self.clients))
        if bending.point.map is None:
            self._spawn(self._map(model))

    def forget(self, model: str) -> None:
        """Drops a beam that was learned again, or one too many; viewers open it again."""
        if self.beams.pop(model, None) is not None:
            self.tell({"what": "forgotten", "model": model})

    async def _show(self, model: str, change: Callable[[], None], clients: tuple[Client, ...]) -> None:
        """The beam after a change of its settings, and its map if there is one."""
        bending = self._beam(model)

        def changed() -> dict[str, Any]:
            change()
            return {"opened": bending.opened(), "answer": bending.still()}

        shown = await self._in_thread(changed)
        for client in clients:
            client.put({"what": "beam", "model": model, **shown})
        await self._show_map(model, bending, clients)
        if bending.hand is not None:
            self._spawn(self._edge(model))

    def _beam(self, model: str) -> Bending:
        if model not in self.beams:
            raise StudioError(f"{model} is not open")
        return self.beams[model]

    async def _answer_drags(self) -> None:
        while True:
            await self._drags.wait()
            self._drags.clear()
            while self._wanted:
                model, (who, n, goal) = self._wanted.popitem()
                bending = self.beams.get(model)
                if bending is None:
                    continue
                try:
                    answer = await self._in_thread(partial(bending.drag, goal))
                except Exception as error:  # whatever it is, the next drag is answered
                    self.tell({"what": "error", "text": said_of(error)})
                    continue
                self.tell({"what": "answer", "model": model, "by": who, "n": n, "answer": answer}, passing=True)
                self._moves[model] = self._moves.get(model, 0) + 1
                if bending.hand is None:
                    self._spawn(self._ellipse(model, self._moves[model]))
                else:
                    self._spawn(self._edge(model))

    async def _aside(self, work: str, *arguments: Any) -> Any:
        """A function of `bending` in the second process, which is restarted if it died."""
        try:
            return await asyncio.get_running_loop().run_in_executor(self.beside, _bend, work, *arguments)
        except BrokenExecutor:
            self.beside = own_process()
            raise StudioError("the process that makes maps ended. Try again") from None

    async def reach(self, beam: str, push_s: float, point_s: float, most: float) -> dict[str, Any]:
        """Outline reachable by forces up to `most` N, of a beam as JSON."""
        return await self._outline(await self._aside("make_map", beam, push_s, point_s, most))

    async def _outline(self, found: ReachMap) -> dict[str, Any]:
        outline: dict[str, Any] = await self._in_thread(partial(_bend, "outline_of", found))
        return outline

    async def _map(self, model: str) -> None:
        bending, version = self.beams[model], self.beams[model].version
        found = await self._aside("make_map", bending.beam, bending.push_s, bending.point_s, bending.max_force)
        if await self._in_thread(lambda: bending.take_map(version, found)):
            await self._show_map(model, bending, tuple(self.clients))

    async def _show_map(self, model: str, bending: Bending, clients: tuple[Client, ...]) -> None:
        if bending.point.map is not None:
            shown = await self._outline(bending.point.map)
            for client in clients:
                client.put({"what": "map", "model": model, "version": bending.version, "map": shown})

    async def _edge(self, model: str) -> None:
        if model in self._busy:
            return
        self._busy.add(model)
        try:
            done = -1
            while done != self._moves.get(model, 0) and (bending := self.beams.get(model)) is not None:
                done, state, hand = self._moves.get(model, 0), bending.state, bending.hand
                if hand is None:
                    return
                edge = await self._aside("hand_edge", bending.beam, state.q, state.load, bending.max_force)
                if bending.hand is hand:  # it may have let go meanwhile
                    self.tell({"what": "edge", "model": model, "edge": edge})
        finally:
            self._busy.discard(model)

    async def _ellipse(self, model: str, moves: int) -> None:
        await asyncio.sleep(_RESTS)
        bending = self.beams.get(model)
        if bending is None or bending.stored.uncertain is None or self._moves.get(model) != moves:
            return
        known, state = bending.stored.uncertain.as_dict(), bending.state
        at = bending.push_s, bending.point_s, state.q, state.load
        with contextlib.suppress(OnebendError):
            found = await self._aside("full_ellipse", bending.beam, known, *at)
            if found is not None and self._moves.get(model) == moves:
                self.tell({"what": "ellipse", "model": model, "ellipse": found})

    def tell(self, message: dict[str, Any], *, passing: bool = False) -> None:
        """To all tabs; slow ones skip `passing` messages."""
        for client in tuple(self.clients):
            client.put(message, passing=passing)

    def shown(self, name: str, room: str) -> dict[str, Any]:
        """The work of a room, under this name."""
        return {name: self.works[room].shown()}

    def _changed(self, room: str, made: bool) -> None:
        job = self.works[room].job
        assert job is not None
        what = {"learn": "job", "record": "recording"}.get(room, "work")
        named = {"what": what, "room": room, **self.shown("job" if what == "work" else what, room)}
        self.tell(named, passing=job.passing)
        if made and "out" in job.wanted:
            self.forget(job.wanted["out"])
            self.tell({"what": "places"})

    def _spawn(self, work: Awaitable[None]) -> None:
        task = asyncio.get_running_loop().create_task(self._watched(work, self.tell))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def request_of(text: str) -> dict[str, Any] | None:
    """A tab's request; None if invalid."""
    try:
        message = json.loads(text)
        return {
            "do": message.get("do"),
            "model": str(message["model"]),
            "n": int(message.get("n", 0)),
            "goal": [float(one) for one in message.get("goal", ())[:3]],
            "settings": Asked(message.get("settings", {})),
        }
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        return None


def said_of(error: Exception) -> str:
    """In words. Faults of onebend are written to a file named in the terminal."""
    if isinstance(error, OnebendError):
        return str(error)
    text = f"{words(error)} {kept(error, onebend.__version__)}"
    tell(text)
    return text


def _bend(function: str, *arguments: Any) -> Any:
    """By a function of `bending`, which is loaded after the page's first picture."""
    return getattr(import_module("onebend.studio.bending"), function)(*arguments)


def _load() -> None:
    before = sys.getswitchinterval()
    sys.setswitchinterval(_TURN)
    try:
        import_module("onebend.studio.bending")
    finally:
        sys.setswitchinterval(before)
