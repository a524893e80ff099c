"""Record: the recording process, and the page's requests to it."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from onebend.errors import OnebendError, StudioError
from onebend.studio.jobs import Job, Jobs, asked_number, ended
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
class MadeRecording(Job):
    """A recording in progress, or the last one."""

    length_m: float = 0.0
    phase: str = "starting"  # recording, stopping, checking, done, failed
    known: dict[str, Any] = field(default_factory=dict)  # from `recorder.state_data`
    curve: dict[str, Any] | None = None  # k(s) so far
    pictures: dict[int, bytes] = field(default_factory=dict)  # the newest, by number
    outcome: dict[str, Any] | None = None
    check: dict[str, Any] | None = None
    passing: bool = False  # what was heard last is soon replaced

    @property
    def goes_on(self) -> bool:
        return self.phase in _GOING

    @property
    def busy(self) -> str:
        return f"{self.wanted['out']} is being recorded. Stop it, or wait"

    def shown(self) -> dict[str, Any]:
        own = {name: getattr(self, name) for name in ("length_m", "phase", "curve", "outcome", "check", "error")}
        now = {"state": self.known, "picture": max(self.pictures, default=0)}
        return {"out": self.wanted["out"], "command": self.wanted["command"], **own, **now}

    def hear(self, said: dict[str, Any]) -> None:
        if "picture" in said:
            self.pictures[max(self.pictures, default=0) + 1] = base64.b64decode(said["picture"])
            for number in sorted(self.pictures)[:-_KEPT]:
                del self.pictures[number]
        self.passing = "state" in said
        if self.passing:
            self.known, self.curve = said["state"], said.get("curve", self.curve)
            if self.phase == "starting":
                self.phase = "recording"
        self.length_m = said.get("length_m", self.length_m)
        if "outcome" in said:
            self.outcome = said["outcome"]
            self.phase = "checking" if self.outcome["begun"] else self.phase
        self.check = said.get("check", self.check)
        self.error = said.get("error", self.error)

    def end(self, code: int) -> None:
        self.passing = False
        if self.goes_on:
            failed = self.outcome is None or bool(self.outcome["fault"]) or not self.outcome["begun"]
            self.phase = "failed" if failed else "done"
        if self.outcome is None and not self.error:
            kept = f"The recording up to then is in {self.wanted['out']}" if self.known.get("frames") else "Try again"
            self.error = f"the recorder ended with {code}. {kept}"


class RecorderProcess(Jobs):
    """At most one recording at a time, in the server's loop."""

    kind = MadeRecording

    def __init__(self, tell: Callable[[dict[str, Any], bool], None]) -> None:
        """`tell`: a message to all tabs, and whether slow ones may skip it."""
        super().__init__("recorder", self._changed, _PATIENCE)
        self._tell = tell

    @property
    def made(self) -> MadeRecording | None:
        return self.job if isinstance(self.job, MadeRecording) else None

    def picture(self, number: int) -> bytes:
        """A JPEG, or the newest. Raises `StudioError` before the first."""
        if self.made is None or not self.made.pictures:
            raise StudioError("no picture came yet")
        return self.made.pictures.get(number) or self.made.pictures[max(self.made.pictures)]

    def begin(self) -> None:
        """Begins the film despite a poor picture."""
        if self.made is not None and self.made.goes_on:
            self.say("begin")

    def end_film(self) -> None:
        """Ends the film and keeps it."""
        if self.made is not None and self.made.phase in ("starting", "recording"):
            self.made.phase = "stopping"
            self.say("stop")
            self.changed()

    async def stop(self) -> None:
        """Ends the film and waits until all is on disk; kills a recorder that does not end."""
        process = self._process
        if process is not None and process.returncode is None and process.stdin is not None:
            process.stdin.close()
            await ended(process, self._patience)

    def _changed(self) -> None:
        made = self.made
        self._tell({"what": "recording", "recording": self.shown()}, made is not None and made.passing)
        if made is not None and not made.goes_on:
            self._tell({"what": "places"}, False)


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
