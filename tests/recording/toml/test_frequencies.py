"""[[frequencies]]: read, refused with the line, and what comes of a recording that holds nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from onebend.errors import RecordingError
from onebend.recording.folder import read_recording
from onebend.recording.observe import observe
from onebend.recording.stated import stated_in

BEAM = 'format = 1\n[beam]\nlength_m = 0.3\nmass_kg = 0.07\nmass_sd_kg = 0.0007\nrest = "straight"\n'
ROW = "[[frequencies]]\nhz = 9.0\nsd_hz = 0.1\n"
FIRST = ROW + "mode = 1\n"


def written(folder: Path, text: str) -> Path:
    (folder / "recording.toml").write_text(text)
    return folder


def test_frequencies_alone_need_no_tags(tmp_path: Path) -> None:
    rows = f"{ROW}mode = 2\nbase_angle_deg = -90\ntip_mass_kg = 0.01\ndamping_ratio = 0.6\n{FIRST}"
    seen = observe(written(tmp_path, BEAM + rows))
    hangs, across = seen.frequencies
    assert (hangs.mode, hangs.tip_mass, across.mode) == (2, 0.01, 1)
    assert hangs.frequency == pytest.approx(9.0 / 0.8)  # sqrt(1 - 0.6^2) = 0.8
    assert hangs.sd == pytest.approx(0.1 / 0.8)
    np.testing.assert_allclose(hangs.gravity, [9.81, 0.0])
    np.testing.assert_array_equal(across.gravity, [0.0, 0.0])
    assert any("across gravity" in remark.text for remark in seen.source.remarks)
    assert stated_in(read_recording(tmp_path)).weighed_sd == pytest.approx(0.01)


def test_a_base_angle_for_all_stands_in_gravity(tmp_path: Path) -> None:
    gravity = "[gravity]\ndirection_deg = -90.0\nbase_angle_deg = 90.0\nmagnitude_m_s2 = 9.8\n"
    (one,) = observe(written(tmp_path, BEAM + gravity + FIRST)).frequencies
    np.testing.assert_allclose(one.gravity, [-9.8, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ("[[frequencies]]\nhz = 9.0\n", r":7: .*lacks sd_hz"),
        ("[[frequencies]]\nhz = -9.0\nsd_hz = 0.1\n", r":8: .*hz .*above 0"),
        ("[[frequencies]]\nhz = 0.1\nsd_hz = 9.0\nmode = 1\n", r":9: .*swapped"),
        (ROW + "mode = 9\n", r":10: .*modes 1 to 8"),
        (ROW + "mode = 1\n" + ROW + "mode = 1\n", r":14: mode 1 is given twice"),
        (FIRST + "base_angle = 3\n", r":11: .*did you mean|Did you mean"),
        ("[frequencies]\nhz = 9.0\nsd_hz = 0.1\n", r":7: .*\[\[frequencies\]\]"),
        (FIRST + "[tags]\nsize_m = 0.01\n", r":11: \[tags\] goes with a film"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(tmp_path: Path, rows: str, says: str) -> None:
    with pytest.raises(RecordingError, match=says):
        read_recording(written(tmp_path, BEAM + rows))


def test_a_lower_mode_that_is_faster_is_refused(tmp_path: Path) -> None:
    rows = f"{ROW}mode = 1\nbase_angle_deg = -90\n{ROW.replace('9.0', '50.0')}mode = 2\nbase_angle_deg = -90\n"
    assert len(observe(written(tmp_path, BEAM + rows)).frequencies) == 2
    with pytest.raises(RecordingError, match="mode 1 at 9000 Hz is no slower than mode 2 at 50"):
        observe(written(tmp_path, BEAM + rows.replace("hz = 9.0", "hz = 9000.0")))
