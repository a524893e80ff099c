"""The results folder: complete or absent, and foreign files stay."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from onebend.errors import ResultsError
from onebend.results.folder import OutputFolder, files_in, foreign_files, own_files, prepare, publish

KIND = "onebend-test-1"


def write(folder: Path, mark: str = "new", figures: tuple[str, ...] = ("a.png",)) -> None:
    """What a run would write: two files, figures, and the summary that lists them."""
    (folder / "model.json").write_text(mark)
    (folder / "figures").mkdir()
    for name in figures:
        (folder / "figures" / name).write_text(mark)
    files = [*files_in(folder), "summary.json"]
    (folder / "summary.json").write_text(json.dumps({"format": KIND, "files": files}))


def earlier(out: Path, mark: str = "old", figures: tuple[str, ...] = ("a.png", "b.png")) -> None:
    out.mkdir()
    write(out, mark, figures)


def place_at(out: Path, *, overwrite: bool = False) -> OutputFolder:
    return prepare(out, kind=KIND, overwrite=overwrite)


def test_results_appear_whole_and_the_workplace_goes(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    publish(place_at(out), write)
    assert files_in(out) == ["figures/a.png", "model.json", "summary.json"]
    assert [path.name for path in out.parent.iterdir()] == ["out"]


def test_an_empty_folder_is_filled(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    publish(place_at(out), write)
    assert (out / "model.json").read_text() == "new"


def test_existing_results_are_refused_before_the_work(tmp_path: Path) -> None:
    out = tmp_path / "out"
    earlier(out)
    with pytest.raises(ResultsError, match=r"already holds results.*--force"):
        place_at(out)
    assert not (tmp_path / "out.partial").exists()


def test_force_replaces_all_that_was_ours(tmp_path: Path) -> None:
    out = tmp_path / "out"
    earlier(out)
    publish(place_at(out, overwrite=True), write)
    assert files_in(out) == ["figures/a.png", "model.json", "summary.json"]
    assert (out / "model.json").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_foreign_files_stay_where_they_are(tmp_path: Path) -> None:
    out = tmp_path / "out"
    earlier(out)
    (out / "notes.txt").write_text("mine")
    (out / "figures" / "mine.png").write_text("mine")
    assert foreign_files(out, KIND) == {"notes.txt", "figures/mine.png"}
    publish(place_at(out, overwrite=True), write)
    assert files_in(out) == ["figures/a.png", "figures/mine.png", "model.json", "notes.txt", "summary.json"]
    assert (out / "model.json").read_text() == "new"
    assert not (tmp_path / "out.partial").exists()


def test_a_stranger_with_our_name_is_not_replaced(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "model.json").write_text("somebody's")
    with pytest.raises(ResultsError, match="not empty"):
        place_at(out)
    with pytest.raises(ResultsError, match=r"model\.json.*--force does not"):
        place_at(out, overwrite=True)
    earlier(tmp_path / "other", figures=("a.png",))
    (tmp_path / "other" / "figures" / "new.png").write_text("mine")
    with pytest.raises(ResultsError, match="did not come from an earlier run"):
        publish(place_at(tmp_path / "other", overwrite=True), lambda folder: write(folder, figures=("new.png",)))
    assert (tmp_path / "other" / "figures" / "new.png").read_text() == "mine"
    assert (tmp_path / "other" / "model.json").read_text() == "old"


def test_results_of_another_kind_are_not_replaced(tmp_path: Path) -> None:
    out = tmp_path / "out"
    earlier(out)
    with pytest.raises(ResultsError, match="--force does not"):
        prepare(out, kind="onebend-other-1", overwrite=True)


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_failed_run_leaves_the_old_results(tmp_path: Path, overwrite: bool) -> None:
    out = tmp_path / "out"
    if overwrite:
        earlier(out)
    place = place_at(out, overwrite=overwrite)

    def fails(folder: Path) -> None:
        (folder / "model.json").write_text("half")
        raise OSError(28, "No space left on device", str(folder / "report.html"))

    with pytest.raises(ResultsError, match=r"report\.html: cannot write the results \(No space left"):
        publish(place, fails)
    assert out.exists() == overwrite
    assert not overwrite or (out / "model.json").read_text() == "old"
    publish(place_at(out, overwrite=overwrite), write)  # and the next run is not in its way
    assert (out / "model.json").read_text() == "new"


def test_a_folder_taken_during_the_work_is_not_overwritten(tmp_path: Path) -> None:
    out = tmp_path / "out"
    place = place_at(out)

    def slow(folder: Path) -> None:
        write(folder)
        earlier(out)

    with pytest.raises(ResultsError, match="already holds results"):
        publish(place, slow)
    assert (out / "model.json").read_text() == "old"
    assert (place.partial / "results" / "model.json").read_text() == "new"


def test_no_results_into_a_recording_nor_onto_a_file(tmp_path: Path) -> None:
    (tmp_path / "recording.toml").write_text("format = 1")
    with pytest.raises(ResultsError, match="this is a recording"):
        place_at(tmp_path, overwrite=True)
    with pytest.raises(ResultsError, match="this is a file"):
        place_at(tmp_path / "recording.toml", overwrite=True)
    with pytest.raises(ResultsError, match="cannot make this folder"):
        place_at(tmp_path / "recording.toml" / "out")


def test_a_summary_cannot_name_files_outside(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    outside = tmp_path / "precious.txt"
    outside.write_text("precious")
    names = ["../precious.txt", str(outside), "..\\precious.txt", "summary.json"]
    (out / "summary.json").write_text(json.dumps({"format": KIND, "files": names}))
    assert own_files(out, KIND) == {"summary.json"}
    publish(place_at(out, overwrite=True), write)
    assert outside.read_text() == "precious"


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"format": "onebend-test-1", "files": 3}'])
def test_a_damaged_summary_claims_nothing(tmp_path: Path, text: str) -> None:
    (tmp_path / "summary.json").write_text(text)
    assert own_files(tmp_path, KIND) == set()
