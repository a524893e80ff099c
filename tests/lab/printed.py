"""Measuring what was made: tags in a rendered page."""

from __future__ import annotations

from functools import cache

import numpy as np
import pypdfium2
from pyapriltags import Detector

from onebend.records import Array

DPI = 600
PX = 25.4 / DPI  # mm


@cache
def detector(family: str) -> Detector:
    return Detector(families=family, nthreads=1, quad_decimate=1.0, refine_edges=1)


def page_image(pdf: bytes, page: int = 0) -> np.ndarray:
    """(H, W) grey levels of a page at `DPI`."""
    document = pypdfium2.PdfDocument(pdf)
    try:
        return np.ascontiguousarray(document[page].render(scale=DPI / 72.0, grayscale=True).to_numpy())
    finally:
        document.close()


def tags_in(image: np.ndarray, family: str = "tag36h11") -> dict[int, Array]:
    """Corners (4, 2) mm from the page's upper left, by id."""
    found = detector(family).detect(image)
    assert len({one.tag_id for one in found}) == len(found)
    return {one.tag_id: np.asarray(one.corners) * PX for one in found}


def black_run(image: np.ndarray, row: float, start: float, end: float) -> tuple[float, float]:
    """mm, where the dark first begins and last ends in a row of the page between `start` and `end` mm."""
    level = image[round(row / PX), round(start / PX) : round(end / PX)] < 128
    dark = np.flatnonzero(level)
    return start + float(dark[0]) * PX, start + float(dark[-1] + 1) * PX
