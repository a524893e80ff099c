"""The folder of a recording: what recording.toml must say, and tables that end with whole rows."""

from __future__ import annotations

import errno
import os
import tomllib
from pathlib import Path

import numpy as np
import pytest

from onebend.errors import RecordingError
from onebend.live.recording_folder import GrowingTable, copy_description, places_for, retimed, state_values, with_values
from onebend.live.sources import files_of
from onebend.live.specs import camera_of, force_of
from onebend.recording.folder import read_recording
from onebend.recording.template import template
from tests.live.streamed import toml

COLUMNS = ("fx_N", "fy_N", "fz_N")


def folder(tmp_path: Path, text: str = "") -> Path:
    (tmp_path / "recording.toml").write_text(text or toml(), encoding="utf-8")
    return tmp_path


def test_the_places_are_those_of_recording_toml(tmp_path: Path) -> None:
    text = toml().replace("[push]", 'columns = ["time_s", "fz_N", "fx_N"]\n[push]')
    found = places_for(folder(tmp_path, text), COLUMNS)
    assert (found.film.name, found.wanted) == ("video.mp4", (2, 0))
    assert found.log is not None
    assert found.log.name == "force.csv"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"video.mp4"', '"video.avi"', "written as MP4"),
        ('"video.mp4"', '"bag.mcap"\ntopic = "/image"', "without topic"),
        ('"force.csv"', '"force.csv"\ntime_unit = "ms"', "without topic and time_unit"),
        ('"force.csv"', '"force.csv"\ncolumns = ["time_s", "Fx", "Fy"]', "column Fx, and the sensor gives fx_N"),
        ("at_s = 1.0", 'column = "push_s"', "the column push_s"),
        ('[force]\nfile = "force.csv"\n[push]\nat_s = 1.0\n', "", "has no \\[force\\]"),
        ("length_m = 0.15", "length_m = 0.15\nlenght_m = 1", "lenght_m"),
    ],
)  # fmt: skip
def test_what_cannot_be_filled_is_refused_before_anything_is_recorded(
    tmp_path: Path, old: str, new: str, says: str
) -> None:
    assert old in toml()
    with pytest.raises(RecordingError, match=says):
        places_for(folder(tmp_path, toml().replace(old, new)), COLUMNS)


def test_a_sensor_is_wanted_where_a_force_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="Give one with --force"):
        places_for(folder(tmp_path), None)


def test_an_earlier_recording_is_kept_unless_told_otherwise(tmp_path: Path) -> None:
    film = folder(tmp_path) / "video.mp4"
    film.write_bytes(b"mine")
    with pytest.raises(RecordingError, match=r"is there already.*--overwrite"):
        places_for(tmp_path, COLUMNS)
    assert film.read_bytes() == b"mine"
    assert places_for(tmp_path, COLUMNS, overwrite=True).earlier == (film,)
    assert film.exists()  # until a new film begins


@pytest.mark.parametrize("name", ["../video.mp4", "/tmp/video.mp4", "link/video.mp4"])
def test_nothing_is_written_out_of_the_recordings_folder(tmp_path: Path, name: str) -> None:
    place = tmp_path / "push"
    place.mkdir()
    (place / "link").symlink_to(tmp_path)
    (tmp_path / "video.mp4").write_bytes(b"mine")
    folder(place, toml().replace('"video.mp4"', f'"{name}"'))
    with pytest.raises(RecordingError, match="out of the recording's folder"):
        places_for(place, COLUMNS, overwrite=True)


def test_a_log_that_is_read_is_not_replaced(tmp_path: Path) -> None:
    place = folder(tmp_path)
    (place / "force.csv").write_bytes(b"fx_N,fy_N")
    read = files_of(None, force_of(f"csv:{place / 'force.csv'}"))
    with pytest.raises(RecordingError, match="would be replaced"):
        places_for(place, COLUMNS, overwrite=True, read=read)
    assert places_for(place, COLUMNS, overwrite=True).earlier


def test_what_ffmpeg_plays_is_not_replaced(tmp_path: Path) -> None:
    place = folder(tmp_path)
    (place / "video.mp4").write_bytes(b"a film")
    for spec in (f"av:{place / 'video.mp4'}", f"av:file:{place / 'video.mp4'}"):
        with pytest.raises(RecordingError, match="would be replaced"):
            places_for(place, COLUMNS, overwrite=True, read=files_of(camera_of(spec)))
    assert files_of(camera_of(f"av:video={'x' * 5000},format=dshow")) == ()


def test_the_start_is_written_and_all_else_stays(tmp_path: Path) -> None:
    text = toml().replace("start_uncertainty_s = 0.3\n", "").replace("start_s", "  start_s") + "# the end\n"
    state_values(folder(tmp_path, text), "video", {"start_s": "0.0", "start_uncertainty_s": "0.012"})
    now = (tmp_path / "recording.toml").read_text(encoding="utf-8")
    before, after = tomllib.loads(text), tomllib.loads(now)
    assert after["video"] == {"file": "video.mp4", "start_s": 0.0, "start_uncertainty_s": 0.012}
    assert {**after, "video": 0} == {**before, "video": 0}
    assert now.endswith("# the end\n")


def test_the_templates_commented_lines_are_filled_in() -> None:
    changed = with_values(template(everything=True), "video", {"start_s": "0.0", "start_uncertainty_s": "0.01"})
    lines = [line for line in changed.splitlines() if line.startswith("start_")]
    assert [line.split("#")[0].split() for line in lines] == [
        ["start_s", "=", "0.0"],
        ["start_uncertainty_s", "=", "0.01"],
    ]
    assert all("force log's clock" in line or "largest error" in line for line in lines)
    assert len(changed.splitlines()) == len(template(everything=True).splitlines())


def test_a_table_that_cannot_be_edited_is_left_alone(tmp_path: Path) -> None:
    text = (
        toml()
        .replace('[video]\nfile = "video.mp4"\n', "")
        .replace("format = 1", 'format = 1\nvideo.file = "video.mp4"')
    )
    text = "\n".join(line for line in text.splitlines() if not line.startswith("start_")) + "\n"
    with pytest.raises(RecordingError, match=r"Write start_s = 0.0, start_uncertainty_s"):
        state_values(folder(tmp_path, text), "video", {"start_s": "0.0", "start_uncertainty_s": "0.01"})
    assert (tmp_path / "recording.toml").read_text(encoding="utf-8") == text


def test_a_table_on_a_full_disk_ends_with_a_whole_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, real = tmp_path / "log.csv", os.write
    table = GrowingTable(path, ("time_s", "fx_N"))
    table.add(np.array([[0.0, 1.0], [0.1, np.nan]]), ("%.3f", "%g"))
    table.flush()

    def full(handle: int, data: bytes) -> int:
        if len(data) > 3:
            return real(handle, bytes(data)[:3])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    table.add(np.array([[0.2, 3.0]]), ("%.3f", "%g"))
    with pytest.raises(OSError, match="No space"):
        table.flush()
    assert path.read_text() == "time_s,fx_N\n0.000,1\n0.100,\n"


def test_times_made_anew_rise_and_keep_their_rows(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,a\n0.0,first\n0.1,third\n0.2,second\n0.3,same\n")
    retimed(path, np.array([1.0, 3.0, 2.0, 3.0]))
    rows = [line.split(",") for line in path.read_text().splitlines()[1:]]
    assert [name for _, name in rows] == ["first", "second", "third", "same"]
    assert np.all(np.diff([float(time) for time, _ in rows]) > 0.0)


@pytest.mark.parametrize(
    ("line", "left"), [('name = "first"  # mine\n', ""), ("'name' = 'first'\r\n", ""), ('name = """\nfirst"""\n', None)]
)
def test_another_push_of_a_beam_has_the_name_of_its_own_folder(tmp_path: Path, line: str, left: str | None) -> None:
    rest = toml().partition("\n")[2]
    (first := tmp_path / "first").mkdir()
    (first / "recording.toml").write_bytes(f"format = 1\n{line}{rest}".encode())
    for _ in range(2):  # the second is after a start that failed
        copy_description(first, tmp_path / "second")
        kept = line if left is None else left
        assert (tmp_path / "second" / "recording.toml").read_bytes() == f"format = 1\n{kept}{rest}".encode()
    assert read_recording(tmp_path / "second", filmed=False).name == ("first" if left is None else "second")
    (tmp_path / "second" / "recording.toml").write_text("format = 1\n", encoding="utf-8")
    with pytest.raises(RecordingError, match="exists already"):
        copy_description(first, tmp_path / "second")
