"""Sources as they are named on the command line: `kind:place,key=value,...`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from onebend.errors import RecordingError
from onebend.live import cameras, force_sensors, played, sources
from onebend.text_files import QUOTED

Options = Mapping[str, str]


Made = TypeVar("Made")


@dataclass(frozen=True)
class SourceKind(Generic[Made]):
    """One way to name a camera, a force sensor, or a robot."""

    example: str
    says: str
    keys: tuple[str, ...]
    make: Callable[[str, Options], Made]


MOST_START, MOST_COUNTS = 1e12, 1e12
MOST_SIDE = MOST_PORT = 65_535  # px, and of a port
MOST_RATE, MOST_FPS = 1e6, 100_000.0  # Hz


def camera_of(spec: str) -> sources.CameraSource:
    """The camera that a spec names, not opened yet.

    Raises:
        RecordingError: there is no such kind, or a key that it does not know.
    """
    return made(spec, CAMERAS, "--camera")


def force_of(spec: str) -> sources.ForceSource:
    """The force sensor that a spec names, not opened yet.

    Raises:
        RecordingError: as `camera_of`.
    """
    return made(spec, FORCES, "--force")


def number(options: Options, key: str, default: float, *, least: float = -math.inf, most: float = math.inf) -> float:
    """A number of a spec's options.

    Raises:
        RecordingError: it is none.
    """
    if key not in options:
        return default
    try:
        value = float(options[key])
    except ValueError:
        value = math.nan
    if not (least <= value <= most and math.isfinite(value)):
        low = "" if least == -math.inf else f" from {least:g}"
        high = "" if most == math.inf else f" to {most:g}"
        raise RecordingError(f"{key}={options[key][:QUOTED]}: this must be a number{low}{high}.")
    return value


def choice(options: Options, key: str, names: Sequence[str]) -> str:
    """One of these names, the first where a spec's options name none. Raises `RecordingError`: another one."""
    value = options.get(key, names[0])
    if value not in names:
        raise RecordingError(f"{key}={value[:QUOTED]}: take {' or '.join(names)}.")
    return value


def made(spec: str, kinds: Mapping[str, SourceKind[Made]], option: str) -> Made:
    """What a spec names, of one of these kinds; `option` is named where that fails. Raises `RecordingError`."""
    head, *more = spec.split(",")
    if head.endswith(":"):
        raise RecordingError(f"{option} {spec}: nothing stands behind the colon. Say where it is: {head}PLACE.")
    kind, colon, place = ("v4l2", ":", head) if head.startswith("/dev/video") else head.partition(":")
    if not colon or kind not in kinds:
        known = ", ".join(one.example for one in kinds.values())
        raise RecordingError(f"{option} {spec}: there is no such source. Name one of: {known}.")
    options = {}
    for part in more:
        key, _, value = part.partition("=")
        if key not in kinds[kind].keys:
            known = ", ".join(kinds[kind].keys) or "none"
            raise RecordingError(f"{option} {spec}: {kind} has no key {key}. Its keys: {known}.")
        options[key] = value
    return kinds[kind].make(place, options)


def _log(place: str, options: Options) -> sources.ForceSource:
    start = number(options, "start_s", math.nan, least=-MOST_START, most=MOST_START)
    return played.played_force(Path(place), start=start)


def _ati(place: str, options: Options) -> sources.ForceSource:
    scale = None
    if "counts" in options:
        per = number(options, "counts", 0.0, least=1e-6, most=MOST_COUNTS)
        torque = number(options, "counts_torque", per, least=1e-6, most=MOST_COUNTS)
        scale = force_sensors.AtiScale(per, torque, number(options, "rate", 0.0, least=0.0, most=MOST_RATE))
    ports = (("port", force_sensors.PORT), ("web_port", force_sensors.WEB_PORT))
    port, web = (int(number(options, key, value, least=1, most=MOST_PORT)) for key, value in ports)
    return force_sensors.AtiForce(place, port=port, web_port=web, scale=scale)


def _names(options: Options, key: str) -> list[str]:
    return [name for name in options.get(key, "").split("/") if name]


def _serial(place: str, options: Options) -> sources.ForceSource:
    where = f"serial:{place}"
    if "columns" not in options:
        raise RecordingError(f"{where}: say what a line holds, as columns=time_ms/fx_N/fy_N. {force_sensors.KNOWN}.")
    cells = force_sensors.cells_of(_names(options, "columns"), _names(options, "zero"), where=where)
    return force_sensors.SerialForce(Path(place), cells, baud=int(number(options, "baud", 115200, least=50, most=1e8)))


def _size(options: Options, default: str) -> tuple[int, int]:
    width, cross, height = options.get("size", default).partition("x")
    sides = [int(side) if side.isdecimal() and len(side) < 6 else 0 for side in (width, height)]
    if not cross or not all(1 <= side <= MOST_SIDE for side in sides):
        raise RecordingError(f"size={options['size'][:QUOTED]}: write width and height in pixels, as size=1280x720.")
    return sides[0], sides[1]


def _v4l2(place: str, options: Options) -> sources.CameraSource:
    width, height = _size(options, "1280x720")
    packed = choice(options, "packed", tuple(cameras.PACKED))
    fps = number(options, "fps", 30.0, least=0.1, most=MOST_FPS)
    asked = {"video_size": f"{width}x{height}", "framerate": f"{fps:g}", "input_format": cameras.PACKED[packed]}
    return cameras.AvCamera(place, "v4l2", {**asked, "fflags": cameras.NONBLOCK})


CAMERAS: dict[str, SourceKind[sources.CameraSource]] = {
    "v4l2": SourceKind(
        "/dev/video0",
        "a camera of Linux, with the kernel's stamps",
        ("size", "fps", "packed"),
        _v4l2,
    ),
    "av": SourceKind(
        "av:PLACE,format=NAME",
        "what FFmpeg opens: a camera of another system, a stream",
        ("format", "framerate", "video_size", "pixel_format"),
        lambda place, options: cameras.AvCamera(
            place, options.get("format", ""), {key: value for key, value in options.items() if key != "format"}
        ),
    ),
    "film": SourceKind(
        "film:REC",
        "a film, or a recording's, played at its own pace",
        (),
        lambda place, _: played.played_camera(Path(place)),
    ),
}
FORCES: dict[str, SourceKind[sources.ForceSource]] = {
    "ati": SourceKind(
        "ati:192.168.1.1",
        "an ATI Net F/T or Axia box on the network",
        ("counts", "counts_torque", "rate", "port", "web_port"),
        _ati,
    ),
    "serial": SourceKind(
        "serial:/dev/ttyUSB0,columns=fx_N/fy_N",
        "a load cell that sends a line of numbers a sample",
        ("columns", "zero", "baud"),
        _serial,
    ),
    "ur": SourceKind(
        "ur:HOST",
        "a Universal Robot's wrench (pip install 'onebend[ur]')",
        ("rate",),
        lambda place, options: force_sensors.UrForce(
            place, rate=number(options, "rate", 500.0, least=1.0, most=MOST_RATE)
        ),
    ),
    "franka": SourceKind(
        "franka:HOST",
        "a Franka arm's estimate (pip install 'onebend[franka]')",
        (),
        lambda place, _: force_sensors.FrankaForce(place),
    ),
    "csv": SourceKind(
        "csv:log.csv",
        "a CSV file that another program is writing",
        ("columns", "zero"),
        lambda place, options: force_sensors.GrowingLog(
            Path(place), _names(options, "columns"), _names(options, "zero")
        ),
    ),
    "log": SourceKind("log:REC", "a force log, or a recording's, played at its own pace", ("start_s",), _log),
}
