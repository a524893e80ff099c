"""Record: the recording process, and the page's requests to it."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path, PurePosixPath
from typing import Any

from onebend.errors import OnebendError, StudioError
from onebend.studio.jobs import asked_number, begun, ended, lines_of
from onebend.studio.places import RECORDING, StudioFolder, is_file, plain_word, record_line

_PATIENCE = 20.0  # s for a stopped recorder to write everything
_KEPT = 8  # pictures
_LONGEST_SPEC = 1000
_FILES = ("film", "log", "csv")  # source kinds that are files
_OF_A_RECORDING = {"film": "video", "log": "force"}  # their parts of a recording
_CAMERA_FORMATS = ("avfoundation", "dshow")
_STREAMS = ("rtsp://", "rtsps://", "rtmp://", "http://", "https://", "udp://", "tcp://", "srt://")
_GOING = ("starting", "recording", "stopping", "checking")
_DEVICES = ("video*", "serial/by-id/*", "ttyUSB*", "ttyACM*")


@dataclass
class MadeRecording:
    """A recording in progress, or the last one."""

    wanted: dict[str, Any]
    length_m: float = 0.0
    phase: str = "starting"  # recording, stopping, checking, done, failed
    state: dict[str, Any] = field(default_factory=dict)  # from `recorder.state_data`
    curve: dict[str, Any] | None = None  # k(s) so far
    picture: int = 0  # of the newest
    outcome: dict[str, Any] | None = None
    check: dict[str, Any] | None = None
    error: str = ""

    @property
    def goes_on(self) -> bool:
        return self.phase in _GOING

    def shown(self) -> dict[str, Any]:
        own = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "wanted"}
        return {"out": self.wanted["out"], "command": self.wanted["command"], **own}


class RecorderProcess:
    """At most one recording at a time, in the server's loop."""

    def __init__(self, tell: Callable[[dict[str, Any], bool], None]) -> None:
        """`tell`: a message to all tabs, and whether slow ones may skip it."""
        self._tell = tell
        self.made: MadeRecording | None = None
        self._pictures: dict[int, bytes] = {}
        self._count = 0
        self._process: asyncio.subprocess.Process | None = None
        self._task: asyncio.Task[None] | None = None

    def shown(self) -> dict[str, Any] | None:
        """None before the first recording."""
        return None if self.made is None else self.made.shown()

    def picture(self, number: int) -> bytes:
        """A JPEG, or the newest. Raises `StudioError` before the first."""
        if not self._pictures:
            raise StudioError("no picture came yet")
        return self._pictures.get(number) or self._pictures[max(self._pictures)]

    async def start(self, wanted: dict[str, Any]) -> None:
        """Raises `StudioError` during another recording."""
        if self.made is not None and self.made.goes_on:
            raise StudioError(f"{self.made.wanted['out']} is being recorded. Stop it, or wait")
        self.made = made = MadeRecording(wanted)
        self._pictures.clear()
        self._process = await begun("recorder")
        self._write(json.dumps(wanted))
        self._task = asyncio.create_task(self._follow(made, self._process))
        self._changed()

    def begin(self) -> None:
        """Begins the film despite a poor picture."""
        if self.made is not None and self.made.goes_on:
            self._write("begin")

    def stop(self) -> None:
        """Ends the film and keeps it."""
        if self.made is not None and self.made.phase in ("starting", "recording"):
            self.made.phase = "stopping"
            self._write("stop")
            self._changed()

    async def end(self) -> None:
        """Stops and waits until all is on disk; kills a recorder that does not end."""
        process = self._process
        if process is None or process.returncode is not None:
            return
        assert process.stdin is not None
        process.stdin.close()
        await ended(process, _PATIENCE)

    def _write(self, line: str) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        with contextlib.suppress(OSError, RuntimeError):  # already ended
            self._process.stdin.write(f"{line}\n".encode())

    async def _follow(self, made: MadeRecording, process: asyncio.subprocess.Process) -> None:
        async for said in lines_of(process):
            self._hear(made, said)
        code = await process.wait()
        if made.phase in _GOING:
            failed = made.outcome is None or bool(made.outcome["fault"]) or not made.outcome["begun"]
            made.phase = "failed" if failed else "done"
        if made.outcome is None and not made.error:
            kept = f"The recording up to then is in {made.wanted['out']}" if made.state.get("frames") else "Try again"
            made.error = f"the recorder ended with {code}. {kept}"
        self._changed()
        self._tell({"what": "places"}, False)

    def _hear(self, made: MadeRecording, said: dict[str, Any]) -> None:
        if "picture" in said:
            self._count += 1
            made.picture, self._pictures[self._count] = self._count, base64.b64decode(said["picture"])
            for number in sorted(self._pictures)[:-_KEPT]:
                del self._pictures[number]
        if "state" in said:
            made.state, made.curve = said["state"], said.get("curve", made.curve)
            if made.phase == "starting":
                made.phase = "recording"
        made.length_m = said.get("length_m", made.length_m)
        if "outcome" in said:
            made.outcome = said["outcome"]
            made.phase = "checking" if made.outcome["begun"] else made.phase
        made.check = said.get("check", made.check)
        made.error = said.get("error", made.error)
        self._changed(passing="state" in said)

    def _changed(self, *, passing: bool = False) -> None:
        self._tell({"what": "recording", "recording": self.shown()}, passing)


def wanted_recording(places: StudioFolder, asked: Mapping[str, Any]) -> dict[str, Any]:
    """The page's request for the recorder. Raises `StudioError` for missing or invalid entries, or paths outside the
    studio's folder."""
    out, like, camera, force = (asked_text(asked, key) for key in ("out", "like", "camera", "force"))
    if not camera:
        raise StudioError("name a camera: /dev/video0, or film:REC to play a recording")
    if not out or places.path(out) == places.root:
        raise StudioError("a recording goes to a folder of its own: name it")
    if is_file(places.path(out) / RECORDING):
        places.recording(out)
    if like:
        beam = getattr(_described(places, places.recording(like)), "beam", None)
        for table in filter(None, (getattr(beam, name, None) for name in ("mass_file", "section_file"))):
            _check_inside(places, table)
    for spec in (camera, force):
        check_source(places, spec)
    flags = {key: asked.get(key) is True for key in ("now", "no_learning", "fast", "overwrite")}
    until = asked.get("until_percent")
    wanted = {
        "folder": str(places.root),
        "out": plain_word(out),
        "like": plain_word(like),
        "camera": camera,
        "force": force,
        "until_percent": None if until is None else asked_number(asked, "until_percent", 0.01, 100.0, 100.0),
        "longest_s": asked_number(asked, "longest_s", 1.0, 1e5, 600.0),
        "crf": round(asked_number(asked, "crf", 0.0, 40.0, 18.0)),
        **flags,
    }
    return {**wanted, "command": record_line(wanted)}


def check_source(places: StudioFolder, spec: str) -> None:
    """Raises `StudioError` for a file outside the studio's folder, or no device. FFmpeg would open any file, so it may
    only open cameras and network streams."""
    head, *options = spec.split(",")
    kind, _, place = ("v4l2", ":", head) if head.startswith("/") else head.partition(":")
    how = next((one.partition("=")[2] for one in options if one.startswith("format=")), "")
    if kind == "v4l2" or (kind == "av" and how == "v4l2"):
        if not re.fullmatch(r"/dev/video\d+", place):
            raise StudioError(f"{place[:100]} is no camera. Cameras of Linux are named as /dev/video0")
    elif kind in _FILES:
        _check_played(places, kind, places.path(place))
    elif kind == "serial":
        if not re.fullmatch(r"/dev/[\w./-]+|COM\d+", place) or ".." in PurePosixPath(place).parts:
            raise StudioError(f"{place[:100]} is no serial port. They are named as /dev/ttyUSB0 or COM3")
    elif kind == "av" and how not in _CAMERA_FORMATS and not (how == "" and place.startswith(_STREAMS)):
        raise StudioError(
            f"{spec[:100]}: here FFmpeg opens cameras, by format={' or '.join(_CAMERA_FORMATS)}, and streams, as "
            "rtsp://HOST. A file is played by film:NAME"
        )


def _check_played(places: StudioFolder, kind: str, path: Path) -> None:
    """Raises `StudioError` where what is played lies out of the studio's folder, by a recording's own words or a
    link."""
    folder = path.parent if path.name == RECORDING else path
    if kind in _OF_A_RECORDING and is_file(folder / RECORDING):
        entry = getattr(_described(places, folder), _OF_A_RECORDING[kind], None)
        path = folder if entry is None else entry.file
    _check_inside(places, path)


def _check_inside(places: StudioFolder, path: Path) -> None:
    for one in (path, *(path.iterdir() if path.is_dir() else ())):  # a bag is a folder of files
        places.inside(one, str(one))


def _described(places: StudioFolder, folder: Path) -> Any:
    """The recording; None where it cannot be read: to say why is its reader's part."""
    from onebend.recording.folder import read_recording  # here: loaded after the page's first picture

    places.inside(folder / RECORDING, str(folder / RECORDING))
    try:
        return read_recording(folder, filmed=False)
    except OnebendError:
        return None


def sources_data(places: StudioFolder) -> dict[str, Any]:
    """Kinds of sources, connected devices, and recordings to play."""
    from onebend.live.specs import CAMERAS, FORCES

    films, logs, begun = [], [], []
    for one in places.found():
        rec = _described(places, places.recording(one.name)) if one.kind == "recording" else None
        if rec is None or rec.video is None or rec.video.topic:
            continue
        begun += [] if rec.video.file.exists() else [one.name]
        films += [one.name] if _is_playable(places, rec.video) else []
        logs += [one.name] if _is_playable(places, rec.force) else []
    plugged = sorted(str(path) for pattern in _DEVICES for path in Path("/dev").glob(pattern))
    kinds = {
        name: [{"example": one.example, "says": one.says, "keys": list(one.keys)} for one in table.values()]
        for name, table in (("cameras", CAMERAS), ("forces", FORCES))
    }
    return {**kinds, "devices": plugged, "films": films, "logs": logs, "begun": begun}


def _is_playable(places: StudioFolder, entry: Any) -> bool:
    """Whether the film or log of a recording is there, in the studio's folder."""
    if entry is None or not entry.file.exists():
        return False
    try:
        _check_inside(places, entry.file)
    except StudioError:
        return False
    return True


def asked_text(asked: Mapping[str, Any], key: str) -> str:
    """Text under this key, or "". Raises `StudioError` for other types or long text."""
    found = asked.get(key) or ""
    if not isinstance(found, str) or len(found) > _LONGEST_SPEC or not found.isprintable():
        raise StudioError(f"{key}: give it as text, in at most {_LONGEST_SPEC} characters")
    return found.strip()
