"""Robot logs: what others wrote into a bag comes out exactly, and what is wrong with a bag is said."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from PIL import Image
from rosbags.rosbag2 import CompressionMode

from onebend.errors import RecordingError
from onebend.recording.bag_topics import COLOURS, picture_of, read_bag_force
from onebend.recording.bags import natural, open_bag
from onebend.recording.entries import ForceEntry, VideoEntry
from onebend.recording.force_log import read_force_log
from onebend.recording.signals import false_zeros, missing
from onebend.recording.video import frame_count, pictures_at, read_frames
from tests.recording import bagged

LOG = bagged.log()
PICTURES = [
    (bagged.START + 1_000_000 + i * 33_333_333, np.arange(48, dtype=np.uint8).reshape(6, 8) + i) for i in range(12)
]
WRITERS: dict[str, Callable[[Path], Path]] = {
    "MCAP": lambda at: bagged.write_mcap(at / "run.mcap", LOG, PICTURES),
    "MCAP in a folder": lambda at: bagged.write_mcap(at / "run.mcap", LOG, PICTURES).parent,
    "MCAP, robot state": lambda at: bagged.write_mcap(at / "run.mcap", LOG, kind="robot"),
    "sqlite3": lambda at: bagged.write_db3(at / "run", LOG),
    "sqlite3 without metadata": lambda at: bagged.write_db3(at / "run", LOG, metadata=False),
    "sqlite3 in eleven parts": lambda at: bagged.write_db3(at / "run", LOG, metadata=False, parts=11),
    "ROS 1": lambda at: bagged.write_ros1(at / "run.bag", LOG, PICTURES),
    "ROS 1, robot state": lambda at: bagged.write_ros1(at / "run.bag", LOG, franka=True),
}


def force_of(path: Path, **more: object) -> ForceEntry:
    return replace(ForceEntry(file=path, topic="/wrench"), **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("writer", WRITERS)
def test_forces_and_stamps_come_out_exactly(tmp_path: Path, writer: str) -> None:
    found = read_bag_force(force_of(WRITERS[writer](tmp_path), axes=("z", "-x")))
    assert np.array_equal(found.time, (LOG.stamp - LOG.stamp[0]) * 1e-9)
    assert np.array_equal(found.force, LOG.force[:, [2, 0]] * [1, -1])
    assert not [remark for remark in found.remarks if remark.level == "warning"]


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE, CompressionMode.STORAGE])
@pytest.mark.parametrize("mcap", [True, False])
def test_packed_bags_are_read(tmp_path: Path, mcap: bool, mode: CompressionMode) -> None:
    if mode == CompressionMode.STORAGE and not mcap:
        return  # there is no such thing
    bag = bagged.write_compressed(tmp_path / "run", LOG, mcap=mcap, mode=mode)
    assert np.array_equal(read_bag_force(force_of(bag)).force, LOG.force[:, :2])


@pytest.mark.parametrize("writer", ["MCAP", "ROS 1"])
def test_pictures_and_their_stamps_come_out_exactly(tmp_path: Path, writer: str) -> None:
    video = VideoEntry(file=WRITERS[writer](tmp_path), topic="image")
    frames = list(read_frames(video))
    assert frame_count(video) == len(frames) == len(PICTURES)
    for i, (frame, (stamp, picture)) in enumerate(zip(frames, PICTURES, strict=True)):
        assert frame.index == i
        assert frame.time == pytest.approx((stamp - PICTURES[0][0]) * 1e-9, abs=1e-12)
        assert np.array_equal(frame.luma, picture)
    [(index, picture)] = pictures_at(video, [3, 99], colour=True)
    assert index == 3
    assert np.array_equal(picture, np.stack([PICTURES[3][1]] * 3, axis=-1))


def test_field_names_the_force_of_a_robot_state(tmp_path: Path) -> None:
    bag = WRITERS["MCAP, robot state"](tmp_path)
    for field in ("k_f_ext_hat_k", "k_f_ext_hat_k.wrench", "k_f_ext_hat_k.wrench.force"):
        tool = read_bag_force(force_of(bag, field=field))
        assert np.array_equal(tool.force, -LOG.force[:, :2])
        assert any("turn with the tool" in remark.text for remark in tool.remarks)
    for field, reason in (("wrong", "o_f_ext_hat_k"), ("time", "no force of three"), ("header.stamp", "no force")):
        with pytest.raises(RecordingError, match=reason):
            read_bag_force(force_of(bag, field=field))


@pytest.mark.parametrize(("kind", "stamped"), [("bare", True), ("stamped", False)])
def test_without_stamps_the_receipt_counts_and_is_said(tmp_path: Path, kind: str, stamped: bool) -> None:
    late = replace(LOG, stamp=LOG.stamp + np.random.default_rng(1).integers(0, 900_000, len(LOG.stamp)))
    bag = bagged.write_mcap(tmp_path / "run.mcap", late, kind=kind, stamped=stamped)
    found = read_bag_force(force_of(bag))
    assert np.array_equal(found.time, (late.stamp - late.stamp[0]) * 1e-9)
    assert any("received" in remark.text and remark.level == "warning" for remark in found.remarks)


def test_one_missing_stamp_among_others_is_left_out_and_late_messages_are_sorted(tmp_path: Path) -> None:
    mixed = LOG.stamp.copy()
    mixed[[20, 21]] = mixed[[21, 20]]
    mixed[40] = 0
    order = replace(LOG, stamp=mixed)
    found = read_bag_force(force_of(bagged.write_db3(tmp_path / "run", order)))
    rest = np.delete(np.arange(len(LOG.stamp)), 40)
    assert np.array_equal(found.time, (LOG.stamp[rest] - LOG.stamp[0]) * 1e-9)
    assert np.array_equal(found.force[[20, 21]], LOG.force[[21, 20], :2])
    said = " ".join(remark.text for remark in found.remarks)
    assert "1 of 60 rows of the force log hold no number" in said
    assert "out of order" in said


def raw_image(picture: np.ndarray, encoding: str, *, pad: int = 0, big: int = 0) -> SimpleNamespace:
    height, width = picture.shape[:2]
    rows = np.ascontiguousarray(picture).view(np.uint8).reshape(height, -1)
    step = rows.shape[1] + pad
    data = np.concatenate([rows, np.full((height, pad), 255, dtype=np.uint8)], axis=1).reshape(-1)
    return SimpleNamespace(height=height, width=width, encoding=encoding, is_bigendian=big, step=step, data=data)


@pytest.mark.parametrize("pad", [0, 5])
def test_every_encoding_gives_the_brightness_and_the_colour(pad: int) -> None:
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (8, 10, 3)).astype(np.uint8)
    grey = np.asarray(Image.fromarray(rgb).convert("L"))
    assert np.array_equal(picture_of(raw_image(grey, "mono8", pad=pad), "here"), grey)
    for name, (size, places) in COLOURS.items():
        stored = np.zeros((8, 10, size), dtype=np.uint8)
        stored[..., list(places)] = rgb
        seen = picture_of(raw_image(stored, name, pad=pad), "here")
        assert np.abs(seen.astype(int) - grey).max() <= 1  # rounding
        assert np.array_equal(picture_of(raw_image(stored, name, pad=pad), "here", colour=True), rgb)
    deep = (grey.astype(np.uint16) << 8) + 77
    assert np.array_equal(picture_of(raw_image(deep.astype("<u2"), "mono16", pad=pad), "here"), grey)
    assert np.array_equal(picture_of(raw_image(deep.astype(">u2"), "mono16", pad=pad, big=1), "here"), grey)
    for name, place in (("yuv422_yuy2", 0), ("uyvy", 1)):
        both = np.full((8, 10, 2), 99, dtype=np.uint8)
        both[..., place] = grey
        assert np.array_equal(picture_of(raw_image(both, name, pad=pad), "here"), grey)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_a_mosaic_of_one_colour_has_its_brightness_everywhere(pattern: str) -> None:
    level = {"r": 200, "g": 120, "b": 40}
    cell = np.array([level[colour] for colour in pattern], dtype=np.uint8).reshape(2, 2)
    seen = picture_of(raw_image(np.tile(cell, (4, 5)), f"bayer_{pattern}8"), "here")
    assert np.all(seen == (200 + 2 * 120 + 40) // 4)


def test_packed_pictures_are_unpacked_and_odd_ones_refused() -> None:
    grey = np.random.default_rng(0).integers(0, 256, (8, 10)).astype(np.uint8)
    stream = BytesIO()
    Image.fromarray(grey).save(stream, "png")
    packed = SimpleNamespace(format="png", data=np.frombuffer(stream.getvalue(), np.uint8))
    assert np.array_equal(picture_of(packed, "here"), grey)
    with pytest.raises(RecordingError, match="cannot be read"):
        picture_of(SimpleNamespace(format="png", data=packed.data[:60]), "here")
    with pytest.raises(RecordingError, match="'32FC1' cannot be read; mono8"):
        picture_of(raw_image(grey, "32FC1"), "here")
    cut = raw_image(grey, "mono8")
    cut.data = cut.data[:-3]
    with pytest.raises(RecordingError, match="Is it cut off"):
        picture_of(cut, "here")


@cache
def whole(writer: str) -> bytes:
    with TemporaryDirectory() as folder:
        path = WRITERS[writer](Path(folder))
        return next(path.glob("*.db3")).read_bytes() if path.is_dir() else path.read_bytes()


@settings(max_examples=25, deadline=None)
@given(part=st.floats(0.0, 1.0, exclude_max=True), writer=st.sampled_from(["MCAP", "ROS 1", "sqlite3"]))
@example(part=0.625, writer="sqlite3")  # within a page of messages, the first of which stand at its end
@example(part=0.999, writer="MCAP")
def test_a_cut_bag_is_refused_and_how_to_mend_it_is_told(part: float, writer: str) -> None:
    data = whole(writer)
    with TemporaryDirectory() as folder:
        path = Path(folder) / ("run" + {"MCAP": ".mcap", "ROS 1": ".bag", "sqlite3": ".db3"}[writer])
        path.write_bytes(data[: int(part * len(data))])
        with pytest.raises(RecordingError, match=r"is no bag, damaged, or without its index .*mcap recover"):
            read_bag_force(force_of(path))


@pytest.mark.parametrize("writer", ["MCAP", "ROS 1"])
def test_a_fault_behind_a_good_index_is_found(tmp_path: Path, writer: str) -> None:
    data = bytearray(whole(writer))
    middle = len(data) // 2
    data[middle : middle + 300] = bytes(300)
    path = tmp_path / ("run.mcap" if writer == "MCAP" else "run.bag")
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=r"run\..* cannot be read: .*damaged"):
        read_bag_force(force_of(path))


def test_a_journal_beside_a_database_is_not_overlooked(tmp_path: Path) -> None:
    folder = bagged.write_db3(tmp_path / "run", LOG)
    (folder / "run_0.db3-wal").write_bytes(b"something")
    with pytest.raises(RecordingError, match="wal_checkpoint"):
        open_bag(folder)


def test_a_bag_is_read_from_a_folder_of_any_name(tmp_path: Path) -> None:
    folder = bagged.write_db3(tmp_path / "50 % #1?", LOG)
    assert np.array_equal(read_bag_force(force_of(folder)).force, LOG.force[:, :2])


def test_other_files_are_refused(tmp_path: Path) -> None:
    for name in ("run.mcap", "run.bag", "run.db3"):
        (tmp_path / name).write_bytes(b"no bag at all, whatever its name")
        with pytest.raises(RecordingError, match="is no bag"):
            open_bag(tmp_path / name)
    with pytest.raises(RecordingError, match="is no bag"):
        open_bag(tmp_path / "absent.mcap")


def test_of_unknown_types_the_way_out_is_named(tmp_path: Path) -> None:
    folder = bagged.write_db3(tmp_path / "run", LOG, kind="my_msgs/msg/Felt")
    with pytest.raises(RecordingError, match=r"field = "):
        read_bag_force(force_of(folder))
    with pytest.raises(RecordingError, match=r"ros2 bag convert"):
        read_bag_force(force_of(folder, field="pull"))


def test_parts_are_read_in_the_order_of_their_numbers() -> None:
    names = ["run_10.db3", "run_2.db3", "run_0.db3"]
    assert sorted(names, key=natural) == ["run_0.db3", "run_2.db3", "run_10.db3"]


def test_forces_in_two_frames_and_zero_forces_are_refused(tmp_path: Path) -> None:
    still = replace(LOG, force=np.zeros_like(LOG.force))
    with pytest.raises(RecordingError, match="every force is zero"):
        read_bag_force(force_of(bagged.write_db3(tmp_path / "zero", still)))
    with pytest.raises(RecordingError, match=r"several frames \(panda_link0, tool\)"):
        read_bag_force(force_of(bagged.write_db3(tmp_path / "two", LOG, frames=("panda_link0", "tool"))))


def test_lost_samples_and_false_zeros_are_found_and_true_ones_kept(tmp_path: Path) -> None:
    time = np.arange(500) / 100
    kept = np.delete(np.arange(500), [50, 51, 52, 300])
    assert missing(time) == 0
    assert missing(time[kept]) == 4
    assert missing(np.sort(np.random.default_rng(0).uniform(0, 5, 500))) == 0  # no rate, nothing to miss
    force = np.random.default_rng(0).normal([2.0, -1.0], 0.02, (500, 2))
    force[100:130] = force[:7] = 0.0
    assert np.flatnonzero(false_zeros(force)).tolist() == [*range(7), *range(100, 130)]
    gentle = np.maximum(np.sin(np.linspace(0, 20, 500)), 0)[:, None] * [1.0, 0.5]
    assert not false_zeros(gentle).any()
    path = tmp_path / "force.csv"
    rows = "\n".join(f"{t},{x},{y}" for t, (x, y) in zip(time[kept], force[kept], strict=True))
    path.write_text(f"time_s,fx_N,fy_N\n{rows}\n", encoding="utf-8")
    found = read_force_log(path, ("time_s", "fx_N", "fy_N"))
    said = " ".join(remark.text for remark in found.remarks)
    assert len(found.time) == 496 - 37
    assert "37 of 496 rows of the force log are exactly zero" in said
