"""A cache of tag detections on disk: an interrupted run does not search the same video again."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from onebend.errors import ResultsError
from onebend.files.single_file import write_file
from onebend.progress import Progress, Silent
from onebend.recording.bags.reader import files_of
from onebend.recording.tags.detection import detect_tags
from onebend.recording.toml.entries import TagsEntry
from onebend.recording.toml.source_entries import VideoEntry
from onebend.records import Detections, Remark


@dataclass(frozen=True)
class DetectionCache:
    """Detections in a folder, each under a key of the files and settings that it was made from."""

    folder: Path
    version: str  # of onebend: another version may find the tags better

    def detect(
        self, video: VideoEntry, tags: TagsEntry, *, threads: int | None = None, progress: Progress = Silent()
    ) -> Detections:
        """As `detect_tags`, but detections of the same video are read from the folder where it has them."""
        files = files_of(video.file) if video.topic else (video.file,)
        files = files if video.frame_times == "container" else (*files, video.frame_times)
        ids = [[tag.id for tag in group] for group in (tags.on_base, tags.on_beam)]
        key = key_of(files, self.version, tags.family, video.fps, ids, video.topic, video.damaged)
        detections = self.load(key)
        if detections is None:
            detections = detect_tags(video, tags, threads=threads, progress=progress)
            self.save(key, detections)
        return detections

    def load(self, key: str) -> Detections | None:
        """The detections under `key`, or None; a file that cannot be read counts as missing."""
        try:
            with self._file(key).open("rb") as stream, np.load(stream, allow_pickle=False) as data:
                remarks = tuple(Remark(**said) for said in json.loads(str(data["remarks"])))
                width, height = (int(n) for n in data["size"])
                return Detections(data["time"], data["tag_id"], data["corners"], width, height, remarks)
        except (OSError, KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile):
            return None

    def save(self, key: str, detections: Detections) -> None:
        """Write `detections` under `key`; the file appears only once it is complete.

        A disk that is full costs the cache alone.
        """
        content = io.BytesIO()
        np.savez_compressed(
            content,
            time=detections.time,
            tag_id=detections.tag_id,
            corners=detections.corners,
            size=np.array([detections.width, detections.height]),
            remarks=np.array(json.dumps([asdict(remark) for remark in detections.remarks])),
        )
        with suppress(ResultsError):
            write_file(self._file(key), content.getvalue(), overwrite=True)

    def _file(self, key: str) -> Path:
        return self.folder / f"detections-{key}.npz"


def key_of(files: tuple[Path, ...], *settings: Any) -> str:
    """A name for "these files as they are now, with these settings" (by path, size and time of change).

    `settings` go in by their `repr`, so they must be plain values or frozen records of such.
    """
    stats = [(str(file.resolve()), file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    return hashlib.sha256(repr((stats, settings)).encode()).hexdigest()[:20]
