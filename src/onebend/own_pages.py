"""Large arrays that stay for long, in memory pages of their own.

The heap grows by what is made and freed around an array that stays, and cannot shrink past it: of a hundred recordings
learned together that was a third of the memory. Pages of its own go back to the system with the array.
"""

from __future__ import annotations

import mmap

import numpy as np
from numpy.typing import NDArray

_WORTH_PAGES = 1 << 18  # bytes: a smaller array stays where it is


def in_own_pages(array: NDArray[np.float64]) -> NDArray[np.float64]:
    """The array, copied to pages of its own where it is large."""
    if array.nbytes < _WORTH_PAGES:
        return array
    rows = array.T if array.flags.f_contiguous else array
    out = np.frombuffer(_pages(array.nbytes), dtype=array.dtype).reshape(rows.shape)
    out[...] = rows
    return out.T if array.flags.f_contiguous else out


def _pages(count: int) -> mmap.mmap:
    """So many bytes, all zero."""
    if hasattr(mmap, "MAP_PRIVATE"):
        return mmap.mmap(-1, count, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    return mmap.mmap(-1, count)
