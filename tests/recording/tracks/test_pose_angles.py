"""Where the clamp's angle of a pose may stand, and its full turns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from onebend.errors import RecordingError
from onebend.recording.observe import observe
from onebend.records import Observations
from tests.recording.tracked import ROD_S, pose_folder

PLAIN = "[gravity]\ndirection_deg = -90\n"
STRAIGHT = 0.5 * np.stack([ROD_S, 0.0 * ROD_S], axis=-1)


def read(folder: Path, loads: str, gravity: str = PLAIN) -> Observations:
    shown = np.stack([STRAIGHT] * (loads.count("\n") - 1))
    return observe(pose_folder(folder, loads=loads, shown=shown, beam="mass_kg = 0.03\n", gravity=gravity, poses=""))


def test_gravity_needs_no_angle_of_the_base_where_every_pose_has_one(tmp_path: Path) -> None:
    o = read(tmp_path, "pose,s,clamp_deg\n0,,0\n1,,90\n")
    np.testing.assert_allclose(o.gravity, [[0.0, -9.81], [-9.81, 0.0]], atol=1e-12)


def test_a_pose_without_an_angle_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"turned in pose 1\. Give clamp_deg there, or base_angle_deg"):
        read(tmp_path, "pose,s,clamp_deg\n0,,0\n1,,\n")


def test_poses_have_no_log_of_the_base(tmp_path: Path) -> None:
    (tmp_path / "base.csv").write_text("time_s,base_deg\n0,0\n1,1\n")
    with pytest.raises(RecordingError, match="poses have no clock"):
        read(tmp_path, "pose,s\n0,\n", PLAIN + 'base_angle_file = "base.csv"\n')


def test_a_film_still_needs_the_angle(tmp_path: Path) -> None:
    folder = pose_folder(tmp_path, loads="pose,s,clamp_deg\n0,,0\n", shown=STRAIGHT[None], gravity=PLAIN)
    film = (folder / "recording.toml").read_text().replace("[poses]", "[markers]").replace('loads = "loads.csv"\n', "")
    (folder / "recording.toml").write_text(film)
    with pytest.raises(RecordingError, match="needs either base_angle_deg or base_angle_file"):
        observe(folder)


def test_an_angle_that_is_read_without_full_turns_gets_them_from_the_points(tmp_path: Path) -> None:
    """A beam rolled into an arc of 250 degrees, to its right; the protractor shows 110 at the tip."""
    alpha = -np.radians(250.0) * ROD_S
    arc = 0.5 * np.stack([np.sin(alpha), 1.0 - np.cos(alpha)], axis=-1) / -np.radians(250.0)
    read_off = (np.degrees(alpha) + 180.0) % 360.0 - 180.0
    shown = np.concatenate([arc, read_off[:, None]], axis=1)[None]
    columns = ("x_m", "y_m", "angle_deg")
    folder = pose_folder(tmp_path, loads="pose,s,fy_N\n0,1,-1\n", shown=shown, gravity="", poses="", columns=columns)
    np.testing.assert_allclose(observe(folder).angle[0], alpha, atol=1e-9)
