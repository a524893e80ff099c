"""The studio's folder, its access rules, and equivalent command lines."""

from __future__ import annotations

import math
import os
import secrets
import shlex
from asyncio import BaseTransport, Transport
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from pathlib import Path, PurePosixPath
from typing import Any, Literal
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from onebend.errors import StudioError
from onebend.files.publish import read_object
from onebend.files.single_file import FILMS, LOGS

RECORDING, RESULT_SUMMARY, MODEL = "recording.toml", "summary.json", "model.json"
_DEEPEST, _MOST_FOLDERS = 5, 5000  # of the search
_LEFT_OUT = frozenset({"node_modules", "__pycache__", "site-packages"})
_LONGEST_PART = 255  # bytes between two /
_LARGEST_SUMMARY = 16 * 2**20  # bytes


@dataclass(frozen=True)
class Found:
    """A recording, a result, or an undescribed film with a log."""

    name: str  # relative, with /; "." is the folder itself
    kind: Literal["recording", "result", "film"]
    changed: float  # s since 1970
    about: dict[str, Any]  # of a result: recordings, grade, known


@dataclass(frozen=True)
class StudioFolder:
    root: Path

    @staticmethod
    def of(folder: Path) -> StudioFolder:
        """Raises `StudioError` if there is no such folder."""
        if not folder.is_dir():
            raise StudioError(f"{folder} is not a folder. Give the one that holds your recordings and results")
        return StudioFolder(folder.resolve())

    def path(self, name: str) -> Path:
        """The path of this name. Raises `StudioError` if it leads out of the folder, by dots, a root or a link."""
        parts = PurePosixPath(name).parts
        odd = not name or any(part in name for part in ("\0", "\\", ":")) or len(name) > 1000
        if odd or not _is_text(name) or PurePosixPath(name).is_absolute() or ".." in parts:
            raise StudioError(f"{name[:100]!r} is no name in this folder")
        if any(len(part.encode()) > _LONGEST_PART for part in parts):
            raise StudioError(f"{name[:30]!r}... is too long a name: a folder's has at most {_LONGEST_PART} bytes")
        return self.inside(self.root / name, name)

    def beside(self, name: str, file: str) -> Path:
        """A file named in folder `name`. Raises `StudioError` if it is outside or missing."""
        if not file or "\0" in file or len(file) > 1000 or not _is_text(file):
            raise StudioError("no file is named")
        return self.inside(self.path(name) / file, file, ": the page does not look there. A check does")

    def inside(self, path: Path, name: str, advice: str = "") -> Path:
        """The path without links. Raises `StudioError`, which says `name`, where it leads out of the folder."""
        try:
            path = path.resolve()
        except (OSError, RuntimeError) as error:
            raise StudioError(f"{name[:100]!r} cannot be read") from error
        if not path.is_relative_to(self.root):
            raise StudioError(f"{name[:100]!r} leads out of {self.root}{advice}")
        return path

    def recording(self, name: str) -> Path:
        """Raises `StudioError` if there is none."""
        return self._holding(name, RECORDING, "")

    def result(self, name: str) -> Path:
        """Raises `StudioError` if there is none."""
        return self._holding(name, MODEL, ": learn a recording first")

    def _holding(self, name: str, file: str, advice: str) -> Path:
        path = self.path(name)
        if not is_file(path / file):
            raise StudioError(f"{name} holds no {file}{advice}")
        self.path(f"{name}/{file}")  # no link to elsewhere
        return path

    def found(self) -> list[Found]:
        """All recordings and results by name, without hidden folders, links and undecodable names."""
        rows, waiting, seen = [], [(self.root, 0)], 0
        while waiting and seen < _MOST_FOLDERS:
            folder, depth = waiting.pop()
            seen += 1
            try:
                with os.scandir(folder) as entries:
                    inside = [
                        one
                        for one in entries
                        if not one.name.startswith(".") and _is_text(one.name) and not one.is_symlink()
                    ]
                    files = {one.name for one in inside if one.is_file(follow_symlinks=False)}
                    below = [Path(one.path) for one in inside if one.is_dir(follow_symlinks=False)]
            except OSError:
                continue
            name = folder.relative_to(self.root).as_posix()
            if RECORDING in files:
                rows.append(Found(name, "recording", _changed(folder / RECORDING), {}))
            elif MODEL not in files and _with_ending(files, FILMS) and _with_ending(files, LOGS):
                rows.append(Found(name, "film", 0.0, {}))
            if {MODEL, RESULT_SUMMARY} <= files:
                rows.append(Found(name, "result", _changed(folder / MODEL), _about(folder / RESULT_SUMMARY)))
            if depth < _DEEPEST:
                waiting += [(one, depth + 1) for one in below if one.name not in _LEFT_OUT]
        return sorted(rows, key=lambda one: (one.name, one.kind))


def _is_text(name: str) -> bool:
    return not any("\ud800" <= one <= "\udfff" for one in name)


def is_file(path: Path) -> bool:
    """False also for too long names."""
    try:
        return path.is_file()
    except OSError:
        return False


def _with_ending(names: set[str], endings: tuple[str, ...]) -> bool:
    return any(name.lower().endswith(endings) for name in names)


def _changed(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _about(path: Path) -> dict[str, Any]:
    data = read_object(path, _LARGEST_SUMMARY) or {}
    try:
        verdict = data["verdict"]
        return {
            "recordings": data["recordings"],
            "grade": verdict["grade"],
            "known": verdict["known"],
            "length_m": data["length_m"],
        }
    except (KeyError, TypeError):
        return {}


# Access: only the page of this studio in a browser on this computer with the token. Every request must name this host
# (against DNS rebinding) and show the cookie; changes and sockets must come from this page (`Origin`).

MOST_STRANGERS = 64  # connections: as many as a system lets wait
Address = tuple[str, int]
SAFE_METHODS = ("GET", "HEAD")
REFUSED = "Open the address that `onebend studio` shows in the terminal: it holds the key to this page.\n"


class Strangers:
    """Connections on which nobody has shown the cookie yet: of too many the oldest ends, so that there is always room
    for the page."""

    def __init__(self, most: int = MOST_STRANGERS) -> None:
        self._most = most
        self._open: dict[Address, BaseTransport] = {}

    def came(self, transport: BaseTransport) -> None:
        self._open[transport.get_extra_info("peername")] = transport
        if len(self._open) > self._most:
            self._open = {who: one for who, one in self._open.items() if not one.is_closing()}
        while len(self._open) > self._most:
            oldest = self._open.pop(next(iter(self._open)))
            oldest.abort() if isinstance(oldest, Transport) else oldest.close()

    def known(self, who: Address) -> None:
        """The cookie was shown on this connection."""
        self._open.pop(who, None)


class Guard:
    """ASGI middleware."""

    def __init__(self, app: ASGIApp, token: str, port: int) -> None:
        self.app, self.token, self.port = app, token, port
        self.strangers = Strangers()
        self.hosts = (f"127.0.0.1:{port}", f"localhost:{port}")
        self.cookie = f"onebend-studio-{port}"  # cookies ignore ports
        self.session = secrets.token_urlsafe(32)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        answer = self._refusal(scope, headers)
        if answer is None and scope.get("client"):
            self.strangers.known(tuple(scope["client"]))
        if scope["type"] == "websocket":
            if answer is None:
                await self.app(scope, receive, send)
            else:
                await send({"type": "websocket.close", "code": 1008, "reason": "not from this page"})
            return
        with_headers = self._sealed(send)
        if answer is not None:
            await answer(scope, receive, with_headers)
            return
        await self.app(scope, receive, with_headers)

    def _refusal(self, scope: Scope, headers: Headers) -> PlainTextResponse | RedirectResponse | None:
        """None: allowed."""
        host = headers.getlist("host")
        if len(host) != 1 or host[0] not in self.hosts:
            return PlainTextResponse("This host is not known here.\n", 403)
        origin = headers.get("origin")
        safe = scope["type"] == "http" and scope["method"] in SAFE_METHODS
        if (origin is not None or not safe) and origin != f"http://{host[0]}":
            return PlainTextResponse("Only this page may ask.\n", 403)
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
            return self._first_visit(scope) or PlainTextResponse("Only this page may ask.\n", 403)
        if self._known(headers):
            return self._first_visit(scope)
        return self._first_visit(scope) or PlainTextResponse(REFUSED, 403)

    def _first_visit(self, scope: Scope) -> RedirectResponse | None:
        """Exchanges the token in the address for a cookie; None for a wrong token."""
        if scope["type"] != "http" or scope["path"] != "/" or scope["method"] not in SAFE_METHODS:
            return None
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])
        if len(given) != 1 or not _same(given[0], self.token):
            return None
        answer = RedirectResponse("/", 303)
        answer.set_cookie(self.cookie, self.session, httponly=True, samesite="strict", path="/")
        return answer

    def _known(self, headers: Headers) -> bool:
        try:
            found = SimpleCookie(headers.get("cookie", "")).get(self.cookie)
        except CookieError:
            return False
        return found is not None and _same(found.value, self.session)

    def _sealed(self, send: Send) -> Send:
        """`send` with security headers."""

        async def sealed(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Content-Security-Policy"] = (
                    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
                    f"connect-src 'self' ws://127.0.0.1:{self.port} ws://localhost:{self.port}; "
                    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
                )
                headers["X-Content-Type-Options"] = "nosniff"
                headers["X-Frame-Options"] = "DENY"
                headers["Referrer-Policy"] = "no-referrer"
                headers["Cross-Origin-Opener-Policy"] = "same-origin"
                headers["Cross-Origin-Resource-Policy"] = "same-origin"
                headers["Cache-Control"] = "no-store"
            await send(message)

        return sealed


def _same(one: str, other: str) -> bool:
    return secrets.compare_digest(one.encode("utf-8", "replace"), other.encode())


# Command lines equivalent to the page's actions.

MOST_DIGITS = 12  # decimals of a goal in metres


def line(*words: str) -> str:
    return shlex.join(["onebend", *words])


def number(value: float) -> str:
    """To a micrometre, or a millionth of the unit."""
    return (f"{value:.6f}".rstrip("0").rstrip(".") or "0") if math.isfinite(value) else "inf"


def rounded(value: float, digits: int) -> str:
    """Without trailing zeros."""
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def reach_line(model: str, goal: Sequence[float], digits: int, push_s: float, point_s: float, max_force: float) -> str:
    """Force for a dragged point; `digits` of the goal in metres."""
    goals = [rounded(one, digits) for one in goal[:2]]
    return line("reach", model, "--goal", *goals, *_places(push_s, point_s), "--max-force-N", number(max_force))


def _places(push_s: float, point_s: float) -> list[str]:
    """Options for places other than the tip."""
    pairs = (("--push-at", push_s), ("--point", point_s))
    return [word for name, s in pairs if s != 1.0 for word in (name, number(s))]


def hand_line(model: str, goal: Sequence[float]) -> str:
    """Wrench of a hand at the end."""
    angle = rounded(math.degrees(goal[2]), MOST_DIGITS - 2)
    goals = [rounded(one, MOST_DIGITS) for one in goal[:2]]
    return line("reach", model, "--goal", *goals, "--goal-angle-deg", angle, "--moment")


def learn_line(recordings: Sequence[str], validate: Sequence[str], out: str, replace: bool) -> str:
    checks = [word for one in validate for word in ("--validate", one)]
    return line("learn", *recordings, "--output", out, *checks, *(["--force"] if replace else []))


def check_line(name: str) -> str:
    return line("check", plain_word(name), "--output", f"{plain_word(name)}/check.png")


def loop_line(wanted: Mapping[str, Any]) -> str:
    """`wanted`: from `looping.wanted_work`."""
    places = _places(wanted["push_s"], wanted["point_s"])
    beams = ["--draws", str(wanted["draws"])] if wanted["draws"] else ["--k-error", number(wanted["k_error"])]
    bound = [] if wanted["max_force_N"] is None else ["--max-force-N", number(wanted["max_force_N"])]
    timing = ["--delay-ms", number(wanted["delay_ms"]), "--fps", number(wanted["fps"])]
    timing += ["--noise-mm", number(wanted["noise_mm"]), "--duration-s", number(wanted["duration_s"])]
    goal = [number(one) for one in wanted["goal_m"]]
    return line("loop", plain_word(wanted["model"]), "--goal", *goal, *places, *beams, *timing, *bound)


def drive_line(wanted: Mapping[str, Any]) -> str:
    """`wanted`: from `driving.wanted_work`."""
    goal = [number(one) for one in wanted["goal_m"]]
    given = [word for key in ("like", "robot", "camera") if wanted[key] for word in (f"--{key}", wanted[key])]
    places = _places(wanted["push_s"], wanted["point_s"])
    return line("drive", plain_word(wanted["model"]), wanted["out"], "--goal", *goal, *places, *given, "--go")


def plain_word(name: str) -> str:
    """A name that no command takes for an option."""
    return f"./{name}" if name.startswith("-") else name


def record_line(wanted: Mapping[str, Any]) -> str:
    """`wanted`: from `filming.wanted_recording`."""
    given = [(f"--{key}", wanted[key]) for key in ("camera", "force", "like") if wanted[key]]
    if wanted["until_percent"] is not None:
        given.append(("--until", f"{number(wanted['until_percent'])}%"))
    given += [] if wanted["longest_s"] == 600.0 else [("--longest-s", number(wanted["longest_s"]))]
    given += [] if wanted["crf"] == 18 else [("--crf", str(wanted["crf"]))]
    flags = [f"--{key.replace('_', '-')}" for key in ("now", "no_learning", "fast", "overwrite") if wanted[key]]
    return line("record", wanted["out"], *(word for pair in given for word in pair), *flags)
