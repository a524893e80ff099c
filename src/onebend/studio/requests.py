"""What the page may ask to be done: the checks of each room, and the command that does it.

Each room returns what its job shows, with the "command" that its process carries out. Raises `StudioError` for missing
or invalid entries, and for paths outside the studio's folder.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from typing import Any

from onebend.errors import OnebendError, StudioError
from onebend.lab.designs import DESIGNS
from onebend.live.specs import CAMERAS, FORCES
from onebend.recording.entries import Recording
from onebend.recording.folder import read_recording
from onebend.studio.places import RECORDING, StudioFolder, is_file
from onebend.studio.words import NUMBERS, Asked, check_line, line, places_of, plain, rounded

MOST_RECORDINGS = 50
_FILES = ("film", "log", "csv")  # source kinds that are files
_OF_A_RECORDING = {"film": "video", "log": "force"}  # their parts of a recording
_CAMERA_FORMATS = ("avfoundation", "dshow")
_STREAMS = ("rtsp://", "rtsps://", "rtmp://", "http://", "https://", "udp://", "tcp://", "srt://")
_DEVICES = ("video*", "serial/by-id/*", "ttyUSB*", "ttyACM*")


def learn(places: StudioFolder, asked: Asked) -> dict[str, Any]:
    recordings, validate = _names(places, asked, "recordings"), _names(places, asked, "validate")
    if not recordings:
        raise StudioError("choose a recording to learn from")
    out = asked.text("out") or f"{Path(recordings[0]).name}-results"
    if places.path(out) == places.root:
        raise StudioError("results go to a folder of their own")
    checks = [word for one in validate for word in ("--validate", one)]
    command = line("learn", *recordings, "--output", plain(out), *checks, force=asked.get("replace") is True)
    return {"recordings": recordings, "validate": validate, "out": out, "command": command}


def check(places: StudioFolder, asked: Asked) -> dict[str, Any]:
    name = asked.name()
    places.recording(name)
    return {"name": name, "command": check_line(name)}


def loop(places: StudioFolder, asked: Asked) -> dict[str, Any]:
    model = asked.name("model")
    places.result(model)
    keys = ("push_s", "point_s", "k_error", "delay_ms", "fps", "noise_mm", "duration_s")
    numbers = {key: asked.number(key) for key in keys}
    draws, most = int(asked.number("draws")), asked.number_if_any("max_force_N")
    goal, at = asked.goal, places_of(numbers["push_s"], numbers["point_s"])
    beams = {"draws": draws} if draws else {"k_error": numbers["k_error"]}
    seen = {key: numbers[key] for key in keys[3:]}
    command = line("loop", plain(model), goal=goal, **at, **beams, **seen, max_force_N=most)
    return {**numbers, "model": model, "goal_m": goal, "draws": draws, "max_force_N": most, "command": command}


def drive(places: StudioFolder, asked: Asked) -> dict[str, Any]:
    model, like, robot, camera, out = (asked.text(key) for key in ("model", "like", "robot", "camera", "out"))
    places.result(model)
    places.recording(like)
    if is_file(_own_folder(places, out, "a drive is recorded into") / RECORDING):
        raise StudioError(f"{out} holds a recording already: name another folder")
    if not robot:
        raise StudioError("name a robot: virtual:linear, or another of docs/drive.md")
    kind, _, where = robot.partition(":")
    if kind == "virtual" and (design := where.split(",")[0]) not in DESIGNS:
        places.path(design)
    if camera:
        check_source(places, camera)
    model, like, out = map(plain, (model, like, out))
    push_s, point_s, goal = asked.number("push_s"), asked.number("point_s"), asked.goal
    seen = {"like": like, "robot": robot, "camera": camera}
    command = line("drive", model, out, goal=goal, **places_of(push_s, point_s), **seen, go=True)
    shown = {"model": model, "out": out, "push_s": push_s, "point_s": point_s, "goal_m": goal}
    return {**shown, **seen, "command": command}


def record(places: StudioFolder, asked: Asked) -> dict[str, Any]:
    out, like, camera, force = (asked.text(key) for key in ("out", "like", "camera", "force"))
    if not camera:
        raise StudioError("name a camera: /dev/video0, or film:REC to play a recording")
    if is_file(_own_folder(places, out, "a recording goes to") / RECORDING):
        places.recording(out)
    if like:
        beam = getattr(_described(places, places.recording(like)), "beam", None)
        for table in filter(None, (getattr(beam, name, None) for name in ("mass_file", "section_file"))):
            _check_inside(places, table)
    for spec in (camera, force):
        check_source(places, spec)
    seen, out = {"camera": camera, "force": force, "like": plain(like)}, plain(out)
    share = asked.number_if_any("until_percent")
    until = None if share is None else f"{rounded(share, 9)}%"
    given = {"longest_s": asked.number("longest_s"), "crf": round(asked.number("crf"))}
    unusual = {key: value for key, value in given.items() if value != NUMBERS[key][-1]}
    flags = {key: asked.get(key) is True for key in ("now", "no_learning", "fast", "overwrite")}
    return {"out": out, "command": line("record", out, **seen, until=until, **unusual, **flags)}


def _names(places: StudioFolder, asked: Asked, key: str) -> list[str]:
    """Recordings of the studio's folder."""
    found = asked.get(key, [])
    if not isinstance(found, list) or len(found) > MOST_RECORDINGS or not all(isinstance(one, str) for one in found):
        raise StudioError(f"{key}: give names of recordings")
    for one in found:
        places.recording(one)
    return [plain(one) for one in found]


def _own_folder(places: StudioFolder, name: str, what: str) -> Path:
    if not name or places.path(name) == places.root:
        raise StudioError(f"{what} a folder of its own: name it")
    return places.path(name)


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


def _described(places: StudioFolder, folder: Path) -> Recording | None:
    """The recording; None where it cannot be read: to say why is its reader's part."""
    places.inside(folder / RECORDING, str(folder / RECORDING))
    try:
        return read_recording(folder, filmed=False)
    except OnebendError:
        return None


def sources_data(places: StudioFolder, _asked: Asked) -> dict[str, Any]:
    """Kinds of sources, connected devices, and recordings to play."""
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
