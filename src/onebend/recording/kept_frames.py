"""Some frames of a film, kept as they pass, so that it is not decoded once more for a few of its pictures.

Of every film those frames are kept whose number is a multiple of a power of two: as many as `MOST_PIXELS` allows. Which
these are follows from the film's length and size alone, so that what is looked at does not depend on what is kept.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

import av
import numpy as np

from onebend.recording.toml.source_entries import VideoEntry
from onebend.recording.video import Picture, picture_in, pictures_at
from onebend.records import IntArray

MOST_PIXELS = 50_000_000  # of all frames that are kept; a pixel takes 1.5 bytes as a rule
FEWEST = 24  # frames: where fewer would fit, none is kept


def spacing_of(count: int, pixels: int) -> int:
    """Every so manyth of the `count` frames of a film is kept, its pictures having so many `pixels`; 0: none is."""
    most = MOST_PIXELS // max(pixels, 1)
    if most < FEWEST:
        return 0
    every = 1
    while -(-count // every) > most:
        every *= 2
    return every


def roundest(frames: IntArray) -> int:
    """The place in `frames` (n,) of the number that the highest power of two divides: the likeliest to be kept."""
    return int(np.argmax(np.where(frames == 0, np.iinfo(np.int64).max, frames & -frames)))


class KeptFrames:
    """Frames of the film that was read last, if it is a video file; those of bags are quickly found again."""

    def __init__(self) -> None:
        """Nothing is kept yet."""
        self._file: Path | None = None
        self._frames: dict[int, av.VideoFrame] = {}

    def __len__(self) -> int:
        """Count of the frames that are kept."""
        return len(self._frames)

    def keep(self, video: VideoEntry, index: int, frame: av.VideoFrame) -> None:
        """Take notice of a frame as it passes; the first of a film takes the place of all that was kept."""
        if index == 0:
            self._file, self._frames = video.file, {}
        every = spacing_of(index + 1, frame.width * frame.height)
        if every and index % every == 0:
            if len(self._frames) * every > index:  # the spacing has just doubled
                self._frames = {i: kept for i, kept in self._frames.items() if i % every == 0}
            self._frames[index] = frame

    def pictures(
        self, video: VideoEntry, indices: Collection[int], *, colour: bool = False
    ) -> Iterator[tuple[int, Picture]]:
        """As `video.pictures_at`; the film is read only for those that are not kept.

        Raises:
            RecordingError: the film cannot be read.
        """
        kept = self._frames if video.file == self._file and not video.topic else {}
        sought = pictures_at(video, set(indices) - kept.keys(), colour=colour)
        found = next(sought, None)
        for index in sorted(set(indices)):
            if index in kept:
                yield index, picture_in(video, index, kept[index], colour=colour)
            elif found is not None and found[0] == index:
                yield found
                found = next(sought, None)
