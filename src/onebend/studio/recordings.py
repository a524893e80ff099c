"""Recordings: `recording.toml` checked while typed and saved whole, the first frame, and a check's picture.

Mistakes come from `recording.folder.check_text`.
"""

from __future__ import annotations

import base64
import hashlib
import io
import threading
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from onebend.cli.common import AnswerOptions
from onebend.errors import RecordingError, ResultsError, StudioError
from onebend.files.single_file import check_replaceable, write_file
from onebend.recording.entries import FAMILIES, VideoEntry
from onebend.recording.folder import check_text
from onebend.recording.tag_finder import Finder
from onebend.recording.template import write_template
from onebend.recording.video import pictures_at
from onebend.report.overview import SOFTWARE, overview
from onebend.studio.places import RECORDING, StudioFolder
from onebend.studio.words import Asked, check_line, object_of, objects_of
from onebend.studio.worker import Studio, end
from onebend.text_files import MOST_TOML

PICTURE = "check.png"
LARGEST_PICTURE = 16 * 2**20  # bytes
WIDEST = 1100  # px
QUALITY = 82  # of JPEG
MOST_SHOWN = 200  # mistakes
_saving = threading.Lock()  # for tabs of this studio


def _text(asked: Asked) -> str:
    text = asked.get("text")
    if not isinstance(text, str) or len(text) > MOST_TOML:
        raise StudioError(f"the text of {RECORDING} has at most {MOST_TOML} characters")
    return text


def read(places: StudioFolder, asked: Asked) -> dict[str, Any]:
    """Text, version and check. Raises `StudioError` if it is no text, or too long."""
    name = asked.name()
    folder = places.recording(name)
    data = (folder / RECORDING).read_bytes()[: MOST_TOML + 1]
    text = as_text(data)
    about = {"name": name, "text": text, "version": version_of(data), "command": check_line(name)}
    return about | checked(folder, text)


def check(places: StudioFolder, asked: Asked) -> dict[str, Any]:
    """Of a text that is not saved."""
    return checked(places.recording(asked.name()), _text(asked))


def as_text(data: bytes) -> str:
    """With one kind of line end."""
    if len(data) > MOST_TOML:
        raise StudioError(f"{RECORDING} is longer than {MOST_TOML} bytes: is it the right file?")
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as wrong:
        line = data[: wrong.start].count(b"\n") + 1
        raise StudioError(f"{RECORDING}, line {line}: no UTF-8. Save it as UTF-8 with another program") from None


def as_bytes(text: str, before: bytes) -> bytes:
    """With the file's line ends and byte-order mark."""
    lines = text.replace("\r\n", "\n")
    try:
        data = (lines.replace("\n", "\r\n") if b"\r\n" in before else lines).encode()
    except UnicodeEncodeError:
        raise StudioError("the text holds half a character, which no file can hold. Type it anew") from None
    mark = b"\xef\xbb\xbf"
    return mark + data if before.startswith(mark) else data


def version_of(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def checked(folder: Path, text: str) -> dict[str, Any]:
    """Mistakes line by line, tags and film."""
    found = check_text(folder, text)
    tags, video = (object_of(found.data.get(name)) for name in ("tags", "video"))
    return {
        "mistakes": [{"line": line, "text": words} for line, words in found.mistakes[:MOST_SHOWN]],
        "remarks": [one.as_dict() for one in found.remarks],
        "tags": [
            {"id": one["id"], "base": group == "on_base", "s": one.get("s")}
            for group in ("on_base", "on_beam")
            for one in objects_of(tags.get(group))
            if isinstance(one.get("id"), int)
        ],
        "family": tags.get("family", FAMILIES[0]),
        "file": video.get("file", ""),
        "topic": video.get("topic", ""),
    }


def save(places: StudioFolder, asked: Asked) -> dict[str, Any]:
    """Replaces the file if it has this version. Returns the new "version", or "conflict" with the file's "text" and
    "version"."""
    path, text = places.recording(asked.name()) / RECORDING, _text(asked)
    with _saving:
        before = path.read_bytes()
        data = as_bytes(text, before)
        if version_of(before) == asked.name("version"):
            write_file(path, data, overwrite=True)
            return {"version": version_of(data)}
    return {"conflict": True, "text": as_text(before[: MOST_TOML + 1]), "version": version_of(before)}


def new(places: StudioFolder, asked: Asked) -> dict[str, Any]:
    """A new file from the template."""
    folder = places.path(asked.name())
    if not folder.is_dir():
        raise StudioError(f"there is no folder {asked.name()}")
    write_template(folder, everything=True)
    return {"name": asked.name()}


def frame(places: StudioFolder, asked: Asked) -> dict[str, Any]:
    """The first frame, and its tags in pixels. Raises `StudioError` for a film outside the studio's folder,
    `RecordingError` if it has no frame."""
    name, file, topic, family = (asked.name(key) for key in ("name", "file", "topic", "family"))
    path = places.beside(name, file)
    if family not in FAMILIES:
        raise StudioError(f"{family[:100]!r} is no family of tags")
    try:
        stamp = path.stat()
    except OSError:
        raise StudioError(f"there is no file {file[:200]}") from None
    return _frame(path, topic, family, stamp.st_mtime_ns, stamp.st_size)


@lru_cache(maxsize=8)
def _frame(path: Path, topic: str, family: str, _changed: int, _size: int) -> dict[str, Any]:
    video = VideoEntry(file=path, topic=topic)
    found = next(iter(pictures_at(video, [0], colour=True)), None)
    if found is None:
        raise RecordingError(f"{path.name} holds no frame. Copy it again from the camera")
    image = Image.fromarray(found[1])
    seen = Finder(family).look(np.asarray(image.convert("L")))
    return {
        "width": image.width,
        "height": image.height,
        "picture": "data:image/jpeg;base64," + jpeg_in(image, WIDEST, QUALITY),
        "tags": [{"id": one.tag_id, "corners": one.corners.round(1).tolist()} for one in seen],
    }


def jpeg_in(picture: Image.Image, widest: int, quality: int) -> str:
    """A picture at most `widest` px wide or high as JPEG, in base64."""
    small, memory = picture.copy(), io.BytesIO()
    small.thumbnail((widest, widest))
    small.save(memory, format="JPEG", quality=quality)
    return base64.b64encode(memory.getvalue()).decode("ascii")


def check_picture_of(places: StudioFolder, asked: Asked) -> bytes:
    """Raises `StudioError` if there is none."""
    name = asked.name()
    places.recording(name)
    path = places.path(f"{name}/{PICTURE}")
    try:
        if path.stat().st_size > LARGEST_PICTURE:
            raise StudioError(f"{PICTURE} is larger than any that is drawn here")
        data = path.read_bytes()
    except OSError:
        raise StudioError(f"there is no {PICTURE} in {name}: check it first") from None
    if not data.startswith(b"\x89PNG") or SOFTWARE.encode() not in data[:200]:
        raise StudioError(f"{PICTURE} in {name} was not drawn by a check")
    return data


def work(studio: Studio, *, recording: Path, output: Path, told: AnswerOptions) -> None:
    """As `onebend check`, and tells where the picture could not be kept."""
    studio.obeyed(end)
    studio.start("reading the files, looking for tags")
    found = overview(recording)
    said = {"name": recording.as_posix(), **found.as_dict(), "faults": found.faults, "picture": False, "unwritten": ""}
    studio.start("drawing the picture")
    from onebend.report.figures import check_png  # here: loads Matplotlib

    drawn = check_png(found)
    try:
        if drawn is not None:
            check_replaceable(output, SOFTWARE, overwrite=told.overwrite)
            write_file(output, drawn, overwrite=True)
            said["picture"] = True
    except ResultsError as error:
        said["unwritten"] = str(error)
    studio.found(said)
