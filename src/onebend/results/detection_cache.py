"""Detections on disk, in the user's cache (`files.kept`), keyed by the SHA-256 of film, search settings and search
code."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from onebend import recording
from onebend.files.kept import KeptFolder, users_folder
from onebend.progress import Progress, Silent
from onebend.recording.bags import files_of
from onebend.recording.entries import TagsEntry, VideoEntry
from onebend.recording.tags import detect_tags
from onebend.records import Detections, Remark
from onebend.results.provenance import checksum_of, inputs_of

FORMAT = 2
LIBRARIES = ("av", "pyapriltags")  # that read films and find tags


@dataclass(frozen=True)
class DetectionCache:
    """Detections from a folder, which gets new ones; None: no cache."""

    folder: KeptFolder | None
    version: str  # of onebend

    def detect(
        self, video: VideoEntry, tags: TagsEntry, *, threads: int | None = None, progress: Progress = Silent()
    ) -> Detections:
        """As `detect_tags`, with the cache."""
        if self.folder is None:
            return detect_tags(video, tags, threads=threads, progress=progress)
        inputs = inputs_of(path for _, path in film_files(video))
        name = f"tags-{key_of(video, tags, self.version)}"
        found = unpacked(self.folder.load(name), [tag.id for tag in (*tags.on_base, *tags.on_beam)])
        if found is None:
            found = detect_tags(video, tags, threads=threads, progress=progress)
            if all(one.is_still_there() for one in inputs):  # else the key is wrong
                self.folder.save(name, packed(found))
        return found


def detection_cache() -> DetectionCache:
    """The user's cache."""
    return DetectionCache(users_folder(), version("onebend"))


def key_of(video: VideoEntry, tags: TagsEntry, version: str) -> str:
    """40 hexadecimal digits of film, tags and version; names of files and later settings do not count."""
    contents = [(kind, checksum_of(one)) for kind, path in film_files(video) for one in inputs_of([path])]
    ids = [[tag.id for tag in group] for group in (tags.on_base, tags.on_beam)]
    settings = (tags.family, ids, video.fps, video.topic)
    return hashlib.sha256(repr((FORMAT, contents, settings, version, finder_version())).encode()).hexdigest()[:40]


def film_files(video: VideoEntry) -> list[tuple[str, Path]]:
    """Files of a film, with the part of the name that decides how it is read."""
    files = files_of(video.file) if video.topic else (video.file,)
    found = [(file.suffix.lower(), file) for file in files]
    if video.topic and video.file.is_dir():
        found += [(file.name, file) for file in sorted(video.file.glob("*.yaml"))]
    if video.frame_times != "container":
        found.append(("frame times", Path(video.frame_times)))
    return found


@cache
def finder_version() -> str:
    """Checksum of the code that reads films and finds tags, and of its libraries' versions."""
    assert recording.__file__ is not None
    folder = Path(recording.__file__).parent
    code = hashlib.sha256()
    for file in sorted(folder.rglob("*.py")):
        code.update(file.read_bytes())
    return repr((code.hexdigest(), [version(name) for name in LIBRARIES]))


def packed(detections: Detections) -> bytes:
    """As a NumPy archive."""
    content = io.BytesIO()
    np.savez_compressed(
        content,
        time=detections.time,
        tag_id=detections.tag_id,
        corners=detections.corners,
        searched=np.ones(len(detections.time), bool) if detections.searched is None else detections.searched,
        size=np.array([detections.width, detections.height]),
        remarks=np.array(json.dumps([asdict(remark) for remark in detections.remarks])),
    )
    return content.getvalue()


def unpacked(content: bytes | None, wanted: Sequence[int]) -> Detections | None:
    """Inverse of `packed`; None if absent or not of the tags `wanted`. Executes nothing."""
    if content is None:
        return None
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as data:
            remarks = tuple(Remark(**said) for said in json.loads(str(data["remarks"])))
            width, height = (int(n) for n in data["size"])
            searched = None if data["searched"].all() else data["searched"]
            found = Detections(data["time"], data["tag_id"], data["corners"], width, height, remarks, searched)
    except (OSError, KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error):
        return None
    shape: tuple[Any, ...] = (len(found.time), len(wanted), 4, 2)
    fits = found.corners.shape == shape and (found.searched is None or found.searched.shape == shape[:1])
    return found if found.tag_id.tolist() == list(wanted) and fits else None
