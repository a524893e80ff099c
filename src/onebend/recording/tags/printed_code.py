"""The cells of a printed tag, from the detector's own table of codes.

The detector finds a tag that is printed from them, with the same number and the same upper edge.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from pyapriltags import Detector

from onebend.errors import RecordingError
from onebend.recording.signals import runs
from onebend.recording.toml.entries import FAMILIES
from onebend.records import Array, BoolArray


@dataclass(frozen=True)
class PrintedTag:
    """A tag's cells. `size_m` of a recording is the side of the square of `border` cells in the middle of them."""

    id: int
    family: str
    cells: BoolArray  # (n, n) True where white; row 0 is the printed upper edge, column 0 the left one
    border: int  # cells along the side of the square whose corners are detected

    @property
    def margin(self) -> int:
        """Cells between the edge of `cells` and the detected square."""
        return (len(self.cells) - self.border) // 2

    @property
    def ink(self) -> Array:
        """(n, 4, 2) corners of the black runs of each row, in cells right of and below the upper left corner."""
        boxes = [
            [[left, row], [right, row], [right, row + 1], [left, row + 1]]
            for row, white in enumerate(self.cells)
            for left, right in runs(~white).tolist()
        ]
        return np.array(boxes, dtype=float)


@dataclass(frozen=True)
class _Family:
    codes: tuple[int, ...]
    border: int
    total: int
    reversed_border: bool
    bit_x: tuple[int, ...]
    bit_y: tuple[int, ...]


def printed_tag(tag_id: int, family: str = FAMILIES[0]) -> PrintedTag:
    """The cells of one tag, its outermost ring included (white for families with a plain black rim).

    Raises:
        RecordingError: an unknown family, or an id that the family does not have.
    """
    layout = _family(family)
    if not 0 <= tag_id < len(layout.codes):
        raise RecordingError(f"{family} has tags 0 to {len(layout.codes) - 1}, not {tag_id}.")
    cells = np.zeros((layout.total, layout.total), dtype=bool)
    ring = layout.border if layout.reversed_border else layout.border + 2  # cells along the side of the white ring
    first, last = (layout.total - ring) // 2, (layout.total + ring) // 2 - 1
    cells[[first, last], first : last + 1] = True
    cells[first : last + 1, [first, last]] = True
    start, code = (layout.total - layout.border) // 2, layout.codes[tag_id]
    for bit, (x, y) in enumerate(zip(layout.bit_x, layout.bit_y, strict=True)):
        if code >> (len(layout.bit_x) - 1 - bit) & 1:
            cells[start + y, start + x] = True
    cells.setflags(write=False)
    return PrintedTag(tag_id, family, cells, layout.border)


@cache
def _family(name: str) -> _Family:
    if name not in FAMILIES:
        raise RecordingError(f"{name!r} is not a family of tags. Take one of {', '.join(FAMILIES)}.")
    detector = Detector(families=name)  # owns the memory that is read below
    table = detector.tag_families[name].contents
    return _Family(
        codes=tuple(int(table.codes[i]) for i in range(table.ncodes)),
        border=int(table.width_at_border),
        total=int(table.total_width),
        reversed_border=bool(table.reversed_border),
        bit_x=tuple(int(table.bit_x[i]) for i in range(table.nbits)),
        bit_y=tuple(int(table.bit_y[i]) for i in range(table.nbits)),
    )
