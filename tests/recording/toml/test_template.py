"""A template that knows what the files beside it tell, asks for the rest, and has tables to fill in."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path

import pytest
import typer

from onebend.cli import recordings as commands
from onebend.errors import ObservationError, RecordingError
from onebend.recording import template as template_module
from onebend.recording.folder import read_recording
from onebend.recording.observe import observe
from onebend.recording.tag_finder import Sighting
from onebend.recording.template import (
    FoundInFiles,
    found_in_folder,
    found_in_log,
    found_in_tracks,
    template,
    write_template,
)
from onebend.recording.video import FilmFrame

EXAMPLES = Path(__file__).parents[3] / "examples"
TRAIN = EXAMPLES / "linear-beam" / "train"


def data(text: str) -> dict[str, object]:
    return tomllib.loads(
        "\n".join(row for row in text.splitlines() if not row.partition("#")[0].rstrip().endswith("="))
    )


@pytest.mark.slow
def test_the_film_tells_its_tags_its_rate_and_its_date(tmp_path: Path) -> None:
    for name in ("video.mp4", "force.csv"):
        shutil.copy(TRAIN / name, tmp_path / name)
    found = found_in_folder(tmp_path, "video")
    assert (found.base, found.beam) == ((0,), (1, 2, 3))  # by what moves least, and then by the distance from it
    assert "30 frames a second, 1280 x 720; tags that stand still: 0; that move: 1, 2, 3" in found.notes[0]
    assert "columns" not in found.values["force"]
    tags = data(write_template(tmp_path).read_text(encoding="utf-8"))["tags"]
    assert isinstance(tags, dict)
    assert [tag["id"] for tag in tags["on_base"]] == [0]
    assert [tag["id"] for tag in tags["on_beam"]] == [1, 2, 3]


@pytest.mark.slow
def test_tags_of_which_none_moves_are_all_on_the_base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    in_film = template_module._tags_in

    def first_again(frames: list[FilmFrame]) -> tuple[str, tuple[tuple[Sighting, ...], ...]]:
        family, (first, *_) = in_film(frames[:1])
        return family, (first,) * len(frames)

    monkeypatch.setattr(template_module, "_tags_in", first_again)
    shutil.copy(TRAIN / "video.mp4", tmp_path)
    tags = data(write_template(tmp_path).read_text(encoding="utf-8"))["tags"]
    assert tags == {"on_base": [{"id": 0}, {"id": 1}, {"id": 2}, {"id": 3}]}


def test_a_film_that_cannot_be_read_is_named_and_noted(tmp_path: Path) -> None:
    (tmp_path / "video.mov").write_bytes(b"no film")
    text = write_template(tmp_path).read_text(encoding="utf-8")
    assert 'file = "video.mov"' in text
    assert "is not a readable video" in text


@pytest.mark.parametrize(
    ("header", "columns", "unit", "note"),
    [
        ("time_s,fx_N,fy_N", None, None, ""),
        ("t_ms,Fx_N,Fy_N,Fz_N", ["t_ms", "Fx_N", "Fy_N"], "ms", ""),
        ("Time,force_x [mN],force_y [mN]", ["Time", "force_x [mN]", "force_y [mN]"], "ms", "is in mN by its name"),
        ("%time,field.wrench.force.x,field.wrench.force.y", ["%time", "field.wrench.force.x", "field.wrench.force.y"],
         "ns", ""),
        ("a,b,c", None, None, ""),
    ],
)  # fmt: skip
def test_a_log_tells_its_columns_and_units(
    tmp_path: Path, header: str, columns: list[str] | None, unit: str | None, note: str
) -> None:
    (tmp_path / "log.csv").write_text(f"{header}\n0,0,0,0\n")
    found = found_in_log(tmp_path / "log.csv")
    keys = data("\n".join(f"{name} = {value}" for name, value in found.values.get("force", {}).items()))
    assert (keys.get("columns"), keys.get("time_unit")) == (columns, unit)
    assert note in " ".join(found.notes)


def test_tracks_tell_their_markers(tmp_path: Path) -> None:
    (tmp_path / "markers.csv").write_text("time_s,id,x_m,y_m\n0,7,0,0\n0,3,0,0\n0.1,7,0,0\n")
    assert found_in_tracks(tmp_path / "markers.csv").beam == (3, 7)


def test_a_trackers_curve_needs_no_markers(tmp_path: Path) -> None:
    (tmp_path / "markers.csv").write_text("time_s,order,x_m,y_m\n0,1,0,0\n0,2,0.1,0\n")
    text = write_template(tmp_path, "mocap").read_text()
    assert "tags" not in text
    assert 'file = "markers.csv"' in text


def test_only_needed_keys_stand_there_unless_all_are_asked_for() -> None:
    few, all_keys = template(), template(everything=True)
    names = {row.split(" = ")[0] for row in few.splitlines() if " = " in row}
    assert names == {"format", "length_m", "size_m", "id", "s", "file", "rotation_deg", "acts_on", "at_s"}
    assert "placement_sd_m" in all_keys
    assert "[gravity]" in all_keys
    assert len(all_keys) > 3 * len(few)


@pytest.mark.parametrize("kind", ["weights", "photos"])
def test_tables_to_fill_in_are_written_and_never_replaced(tmp_path: Path, kind: str) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").write_bytes(b"")
    write_template(tmp_path, kind)  # type: ignore[arg-type]
    loads = (tmp_path / "loads.csv").read_text()
    assert loads.splitlines() == ["pose,s,mass_kg", "a.jpg,," if kind == "photos" else "bare,,"]
    assert (tmp_path / "poses.csv").exists() == (kind == "weights")
    (tmp_path / "loads.csv").write_text("mine")
    (tmp_path / "recording.toml").unlink()
    write_template(tmp_path, kind)  # type: ignore[arg-type]
    assert (tmp_path / "loads.csv").read_text() == "mine"


def with_points(folder: Path) -> Path:
    """The hung weights with [[points]] in place of [[tags.on_beam]]."""
    shutil.copytree(EXAMPLES / "hung-weights", folder, dirs_exist_ok=True)
    file = folder / "recording.toml"
    text = file.read_text(encoding="utf-8").replace("[[tags.on_beam]]", "[[points]]")
    file.write_text(text, encoding="utf-8")
    return folder


def test_hand_readings_name_their_points(tmp_path: Path) -> None:
    found, usual = read_recording(with_points(tmp_path)), read_recording(EXAMPLES / "hung-weights")
    assert found.tags == usual.tags
    file = tmp_path / "recording.toml"
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace("s = 0.4", "s = 4"), encoding="utf-8")
    with pytest.raises(RecordingError, match=r"recording\.toml:\d+: \[points\] \(entry 2\) s must be"):
        read_recording(tmp_path)
    file.write_text(text + "\n[[tags.on_beam]]\nid = 9\ns = 0.9\n", encoding="utf-8")
    with pytest.raises(RecordingError, match="Write all of them as"):
        read_recording(tmp_path)
    shutil.copytree(TRAIN, tmp_path / "film")
    film = tmp_path / "film" / "recording.toml"
    film.write_text(film.read_text(encoding="utf-8").replace("[[tags.on_beam]]", "[[points]]"), encoding="utf-8")
    with pytest.raises(RecordingError, match=r"\[\[points\]\] go with \[poses\]"):
        read_recording(tmp_path / "film")


def test_grams_for_kilograms_in_the_loads_are_refused_by_the_beams_weight(tmp_path: Path) -> None:
    loads = with_points(tmp_path) / "loads.csv"
    rows = [row.split(",") for row in loads.read_text().splitlines()]
    grams = [rows[0], *([pose, s, f"{1000.0 * float(mass):g}" if mass else ""] for pose, s, mass in rows[1:])]
    loads.write_text("\n".join(map(",".join, grams)) + "\n")
    with pytest.raises(ObservationError, match=r"2.22e\+03 times the beam's weight: is mass_kg of the loads in grams"):
        observe(tmp_path)


def test_answers_are_checked_and_written_where_the_template_is_empty(monkeypatch: pytest.MonkeyPatch) -> None:
    given = iter(["wide", "0.15", "", "90", "robot"])
    monkeypatch.setattr(typer, "prompt", lambda *_, **__: next(given))
    text = template(found=FoundInFiles(base=(0,), beam=(1,)))
    wanted = {"length_m", "size_m", "acts_on", "rotation_deg"}
    asked: list[str] = []

    def ask(place: tuple[str | int, ...], says: str) -> str:
        asked.append(str(place[-1]))
        return commands.ask(place, says) if place[-1] in wanted else ""

    monkeypatch.setattr("onebend.cli.common.say", lambda *_: None)
    order = [name for name in ("length_m", "size_m") if name in text]
    found = data(commands.answered(text, ask))
    assert asked[:2] == order
    assert "at_s" in asked
    assert found["beam"] == {"length_m": 0.15}  # "wide" was refused and asked for again
    assert found["tags"] == {"on_base": [{"id": 0}], "on_beam": [{"id": 1}]}
    assert found["force"] == {"file": "force.csv", "rotation_deg": 90, "acts_on": "robot"}
