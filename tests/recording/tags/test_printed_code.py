"""Printed tags: what is drawn is what the detector reads, the same way up."""

from __future__ import annotations

import numpy as np
import pytest
from pyapriltags import Detector

from onebend.errors import RecordingError
from onebend.recording.entries import FAMILIES
from onebend.recording.tag_finder import printed_tag

CELL = 12  # px


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_is_read_back_upright(family: str) -> None:
    detector = Detector(families=family, nthreads=1, quad_decimate=1.0)
    last = int(detector.tag_families[family].contents.ncodes) - 1
    for tag_id in (0, 1, 7, last // 2, last):
        tag = printed_tag(tag_id, family)
        grey = np.full(((len(tag.cells) + 6) * CELL,) * 2, 255, dtype=np.uint8)
        start, side = 3 * CELL, len(tag.cells) * CELL
        grey[start : start + side, start : start + side] = np.kron(tag.cells, np.full((CELL, CELL), 255)).astype(
            np.uint8
        )
        (found,) = detector.detect(grey)
        assert found.tag_id == tag_id
        assert found.hamming == 0
        near, far = start + tag.margin * CELL, start + (tag.margin + tag.border) * CELL
        corners = [[near, far], [far, far], [far, near], [near, near]]  # bottom-left, then counter-clockwise
        np.testing.assert_allclose(found.corners, corners, atol=1.0)


def test_what_does_not_exist_is_refused() -> None:
    with pytest.raises(RecordingError, match=r"tags 0 to 586, not 587"):
        printed_tag(587)
    with pytest.raises(RecordingError, match=r"tags 0 to 586, not -1"):
        printed_tag(-1)
    with pytest.raises(RecordingError, match="not a family"):
        printed_tag(0, "tag99")
