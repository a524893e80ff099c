"""recording.toml: what is accepted, what is refused, and that every refusal points at its line."""

from __future__ import annotations

import dataclasses
import math
import re
import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from onebend.errors import RecordingError
from onebend.recording import entries, entries as beam_entry, entries as source_entries
from onebend.recording.entries import BeamEntry, CameraEntry, ForceEntry
from onebend.recording.folder import read_recording
from onebend.recording.schema import keys_of, lines_of_keys
from onebend.recording.template import Kind, template, write_template

FULL = """\
format = 1
name = "bench 3"

[beam]
length_m = 0.15
mass_kg = 0.08
rest = "unknown"

[tags]
family = "tag36h11"
size_m = 0.012
placement_sd_m = 0.0002

[[tags.on_base]]
id = 0
s = 0
turn_deg = 90

[[tags.on_beam]]
id = 1
s = 0.5
turn_deg = -90.0

[[tags.on_beam]]
id = 2
s = 1

[camera]
width = 1280
height = 720
fx = 1199.89
fy = 1199.43
cx = 633.0
cy = 353.98
dist = [-0.06, 0.02, 0.0004, -0.0003]

[video]
file = "video.mp4"
fps = 30
start_s = 255.64
start_uncertainty_s = 2.0

[force]
file = "force.csv"
rotation_deg = 30.0
acts_on = "robot"
sensor = "franka-estimate"
zeroed = false
white_sd_N = 0.03

[push]
at_s = 0.8

[gravity]
magnitude_m_s2 = 9.81
direction_deg = -90.0
base_angle_deg = -90.0
"""


def folder_with(folder: Path, content: str) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "recording.toml").write_text(content, encoding="utf-8")
    for name in ("video.mp4", "force.csv"):
        (folder / name).write_bytes(b"")
    return folder


def refusal(folder: Path, content: str) -> str:
    with pytest.raises(RecordingError) as raised:
        read_recording(folder_with(folder, content))
    return str(raised.value)


def line_of(content: str, start: str) -> int:
    return next(i for i, row in enumerate(content.splitlines(), start=1) if row.startswith(start))


def test_full_recording_is_read_in_si_and_radians(tmp_path: Path) -> None:
    recording = read_recording(folder_with(tmp_path, FULL))
    assert recording.name == "bench 3"
    assert (recording.beam.length, recording.beam.mass, recording.beam.rest) == (0.15, 0.08, "unknown")
    assert math.isnan(recording.beam.width)
    assert [tag.id for tag in recording.tags.on_beam] == [1, 2]
    assert recording.tags.on_base[0].turn == pytest.approx(math.pi / 2)
    assert recording.tags.on_beam[1].turn == 0.0
    assert recording.camera is not None
    assert recording.camera.dist == (-0.06, 0.02, 0.0004, -0.0003)
    assert recording.video is not None
    assert recording.video.file == tmp_path / "video.mp4"
    assert recording.video.frame_times == "container"
    assert recording.force is not None
    assert recording.force.rotation == pytest.approx(math.pi / 6)
    assert recording.force.columns == ("time_s", "fx_N", "fy_N")
    assert (recording.force.white_sd, recording.force.acts_on) == (0.03, "robot")
    assert math.isnan(recording.force.bias_sd)
    assert recording.push == entries.PushEntry(at=0.8)
    assert recording.gravity is not None
    assert recording.gravity.base_angle == pytest.approx(-math.pi / 2)
    assert recording.remarks == ()


def test_what_is_not_said_is_unknown_and_remarked(tmp_path: Path) -> None:
    content = FULL.replace("placement_sd_m = 0.0002\n", "").replace("start_s = 255.64\n", "")
    recording = read_recording(folder_with(tmp_path, content))
    assert recording.video is not None
    assert math.isnan(recording.video.start)
    assert recording.video.start_uncertainty == math.inf
    assert recording.tags.placement_sd == entries.DEFAULT_PLACEMENT_SD
    assert len(recording.remarks) == 2


@pytest.mark.parametrize(
    ("old", "new", "row", "words"),
    [
        ("length_m = 0.15", "lenght_m = 0.15", "lenght_m", ["[beam]", "Did you mean length_m?"]),
        ("length_m = 0.15\n", "", "[beam]", ["lacks length_m"]),
        ("length_m = 0.15", "length_m = -0.15", "length_m", ["above 0", "-0.15"]),
        ("length_m = 0.15", "length_m = nan", "length_m", ["above 0", "nan"]),
        ("length_m = 0.15", 'length_m = "15 cm"', "length_m", ["a number", "15 cm"]),
        ("length_m = 0.15", "length_m = true", "length_m", ["a number", "True"]),
        ('rest = "unknown"', 'rest = "strait"', "rest", ['did you mean "straight"']),
        ("s = 0.5", "s = 1.5", "s = 1.5", ["[tags.on_beam] (entry 1)", "between 0 and 1"]),
        ("id = 2", "id = 1", "id = 1", ["tag id 1 is given twice"]),
        ("id = 2", "id = 2.5", "id = 2.5", ["whole number"]),
        ('family = "tag36h11"', 'family = "tag36h10"', "family", ['did you mean "tag36h11"']),
        ("fps = 30", "fps = 0", "fps", ["above 0"]),
        ('"video.mp4"', '"vide.mp4"', "file", ["there is no file", "Did you mean video.mp4?"]),
        ('"force.csv"', '"log.csv"', 'file = "log', ["there is no file", "log.csv"]),
        ("dist = [-0.06, 0.02, 0.0004, -0.0003]", "dist = [1.0]", "dist", ["list of 4 or 5"]),
        ("dist = [-0.06, 0.02,", 'dist = ["a", 0.02,', "dist", ["each entry is a number"]),
        ("at_s = 0.8", "", "[push]", ["either at_s", "column"]),
        ("at_s = 0.8", "at_s = 0", "at_s", ["above 0"]),
        ("[push]\nat_s = 0.8\n", "", "[force]", ["no [push]", "at_s = 1.0"]),
        ("base_angle_deg = -90.0", "", "[gravity]", ["base_angle_deg", "base_angle_file"]),
        ("zeroed = false", "zeroed = 0", "zeroed", ["true or false"]),
        ("format = 1", "format = 2", "format", ["format must be 1"]),
        ("[beam]", "[bean]", "[bean]", ["Did you mean beam?"]),
        ("[gravity]", "[poses]\n[gravity]", "[poses]", ["one of them"]),
        ('name = "bench 3"', "name = 3", "name", ["text in quotes"]),
    ],
)
def test_mistake_is_named_with_its_line(tmp_path: Path, old: str, new: str, row: str, words: list[str]) -> None:
    content = FULL.replace(old, new, 1)
    assert content != FULL
    told = refusal(tmp_path, content)
    expected = [i for i, text in enumerate(content.splitlines(), start=1) if text.startswith(row)]
    assert any(f"recording.toml:{line}: " in told for line in expected), told
    for word in words:
        assert word in told


def test_all_mistakes_are_told_at_once(tmp_path: Path) -> None:
    told = refusal(tmp_path, FULL.replace("length_m", "lenght_m").replace("fps = 30", "fps = 0"))
    assert "lenght_m" in told
    assert "fps" in told


def test_missing_tables_and_tags_are_named(tmp_path: Path) -> None:
    told = refusal(tmp_path, "format = 1\n")
    for name in ("[beam]", "[tags]", "[video]"):
        assert f"lacks the table {name}" in told
    start, end = FULL.index("[[tags.on_base]]"), FULL.index("[[tags.on_beam]]")
    assert "[[tags.on_base]]" in refusal(tmp_path, FULL[:start] + FULL[end:])


def test_tables_of_the_wrong_kind_are_refused(tmp_path: Path) -> None:
    for table in ("beam", "tags", "video"):
        start = FULL.index(f"[{table}]")
        told = refusal(tmp_path, f"{table} = 3\n" + FULL[:start])
        assert "recording.toml:1:" in told or "lacks" in told


def test_no_folder_no_file_no_toml(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="is not a folder"):
        read_recording(tmp_path / "nowhere")
    with pytest.raises(RecordingError, match="onebend new"):
        read_recording(tmp_path)
    assert "not valid TOML" in refusal(tmp_path, "format = = 1")
    (tmp_path / "recording.toml").write_bytes(b'name = "\xff"')
    with pytest.raises(RecordingError, match="UTF-8"):
        read_recording(tmp_path)


ANSWERS = {
    "length_m": "0.15", "size_m": "0.012", "mass_kg": "0.05", "acts_on": '"beam"', "rotation_deg": "0", "at_s": "1.0",
    "axes": '"room"', "base_angle_deg": "0.0", "id": "0 1 2 3", "s": "0.3 0.6 1.0",
}  # fmt: skip


def filled_in(text: str) -> str:
    """A template as a person leaves it."""
    several = {name: iter(value.split()) for name, value in ANSWERS.items() if name in ("id", "s")}
    base = "[[tags.on_base]]" in text
    if not base:
        next(several["id"])

    def fill(found: re.Match[str]) -> str:
        name = found[1]
        return f"{name} = {next(several[name]) if name in several else ANSWERS[name]}  #"

    return re.sub(r"^(\w+) = +#", fill, text, flags=re.MULTILINE)


KINDS: tuple[Kind, ...] = ("video", "photos", "weights", "mocap")


@pytest.mark.parametrize("kind", KINDS)
def test_a_template_is_a_recording_once_it_is_filled_in(tmp_path: Path, kind: Kind) -> None:
    path = write_template(tmp_path / "new", kind)
    with pytest.raises(RecordingError) as refused:
        read_recording(path.parent)
    empty = [row for row in path.read_text(encoding="utf-8").splitlines() if re.match(r"\w+ = +#", row)]
    lines = str(refused.value).splitlines()
    assert len(lines) == len(empty)
    assert re.search(r"recording\.toml:\d+: \[beam\] length_m is empty\. Fill it in: the beam's length", lines[0])
    for file in ("poses.csv", "loads.csv", "markers.csv"):
        (path.parent / file).write_text("pose\n")
    (path.parent / "photos").mkdir()
    recording = read_recording(folder_with(path.parent, filled_in(path.read_text(encoding="utf-8"))))
    assert [tag.id for tag in recording.tags.on_beam] == [1, 2, 3]
    assert [tag.s for tag in recording.tags.on_beam] == [0.3, 0.6, 1.0]
    assert not math.isfinite(recording.start[0])  # nothing is taken of the clocks that nobody wrote
    sources = {"video": recording.video, "photos": recording.photos, "weights": recording.poses,
               "mocap": recording.markers}  # fmt: skip
    assert [name for name, source in sources.items() if source is not None] == [kind]
    live = [row for row in path.read_text(encoding="utf-8").splitlines() if row and not row.startswith(("#", "["))]
    assert len(live) <= 19
    with pytest.raises(RecordingError, match="exists already"):
        write_template(path.parent)


def test_template_examples_all_keep_the_schema() -> None:
    uncommented = [
        row[2:] if row.startswith("# ") and (" = " in row or row[2] == "[") else row
        for row in filled_in(template(everything=True)).splitlines()
    ]
    data = tomllib.loads("\n".join(uncommented))
    for record, table in ((BeamEntry, "beam"), (CameraEntry, "camera"), (ForceEntry, "force")):
        for entry, _ in keys_of(record).values():
            entry.check(data[table][entry.name])


def test_every_entry_is_frozen() -> None:
    for record in (*vars(entries).values(), *vars(beam_entry).values(), *vars(source_entries).values()):
        if dataclasses.is_dataclass(record):
            assert vars(record)["__dataclass_params__"].frozen


NAMES = st.text("abcdefgh_", min_size=1, max_size=8)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.lists(st.tuples(NAMES, st.lists(NAMES, max_size=4, unique=True)), max_size=5))
def test_lines_point_at_the_keys(tables: list[tuple[str, list[str]]]) -> None:
    rows = [row for name, keys in tables for row in (f"[[{name}]]", *(f"{key} = 1" for key in keys))]
    found = lines_of_keys("\n".join(rows))
    for place, line in found.items():
        assert str(place[-1] if isinstance(place[-1], str) else place[-2]) in rows[line - 1]
    assert sum(isinstance(place[-1], int) for place in found) == len(tables)
