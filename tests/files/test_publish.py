"""The results folder: complete or absent, and what is not ours stays."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from onebend.errors import ResultsError
from onebend.files.publish import (
    OutputFolder,
    abandon,
    amend,
    changed_files,
    files_in,
    finish,
    own_files,
    prepare,
    publish,
    read_summary,
    sha256_of,
    unplaced,
    write_summary,
)

KIND = "onebend-test-1"


def write(folder: Path, mark: str = "new", figures: tuple[str, ...] = ("a.png",), kind: str = KIND) -> None:
    """What a run would write: a model, figures, and the summary."""
    (folder / "model.json").write_text(mark)
    (folder / "figures").mkdir()
    for name in figures:
        (folder / "figures" / name).write_text(mark)
    write_summary(folder, {"format": kind, "mark": mark})


@contextmanager
def place_at(out: Path, *, overwrite: bool = False, kind: str = KIND) -> Iterator[OutputFolder]:
    """As the command line works."""
    place = prepare(out, kind=kind, overwrite=overwrite)
    try:
        yield place
    except BaseException:
        abandon(place)
        raise
    finish(place)


def run(out: Path, mark: str = "new", figures: tuple[str, ...] = ("a.png",), *, overwrite: bool = False) -> None:
    with place_at(out, overwrite=overwrite) as place:
        publish(place, partial(write, mark=mark, figures=figures))


def earlier(out: Path, mark: str = "old", figures: tuple[str, ...] = ("a.png", "b.png")) -> None:
    run(out, mark, figures)


def test_results_appear_whole_and_the_workplace_goes(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    run(out)
    assert files_in(out) == ["figures/a.png", "model.json", "summary.json"]
    assert [path.name for path in out.parent.iterdir()] == ["out"]
    summary = read_summary(out)
    assert summary is not None
    assert summary["files"]["model.json"] == sha256_of(out / "model.json")


def test_an_empty_folder_is_filled_and_keeps_its_rights(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir(mode=0o700)
    run(out)
    assert (out / "model.json").read_text() == "new"
    assert out.stat().st_mode & 0o777 == 0o700


def test_existing_results_are_refused_before_the_work(tmp_path: Path) -> None:
    out = tmp_path / "out"
    earlier(out)
    with pytest.raises(ResultsError, match=r"already holds results.*--force"):
        prepare(out, kind=KIND, overwrite=False)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_force_replaces_all_that_was_ours(tmp_path: Path) -> None:
    out = tmp_path / "out"
    earlier(out)
    run(out, overwrite=True)
    assert files_in(out) == ["figures/a.png", "model.json", "summary.json"]
    assert (out / "model.json").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_what_is_not_ours_stays_where_it_is(tmp_path: Path) -> None:
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    earlier(out)
    elsewhere.mkdir()
    (out / "notes.txt").write_text("mine")
    (out / "figures" / "mine.png").write_text("mine")
    (out / "empty").mkdir()
    (out / "link").symlink_to(elsewhere)
    (out / "dangling").symlink_to("nowhere")
    (out / "mine" / "deep").mkdir(parents=True)
    (out / "mine" / "deep" / "data.csv").write_text("mine")
    (out / "mine").chmod(0o500)
    number = (out / "notes.txt").stat().st_ino
    run(out, overwrite=True)
    names = ["figures/a.png", "figures/mine.png", "mine/deep/data.csv", "model.json", "notes.txt", "summary.json"]
    assert files_in(out) == names
    assert (out / "model.json").read_text() == "new"
    assert (out / "empty").is_dir()
    assert (out / "link").readlink() == elsewhere
    assert os.path.lexists(out / "dangling")
    assert (out / "mine").stat().st_mode & 0o777 == 0o500
    assert (out / "notes.txt").stat().st_ino == number  # the very file, not a copy
    assert sorted(path.name for path in tmp_path.iterdir()) == ["elsewhere", "out"]
    (out / "mine").chmod(0o700)


def test_a_stranger_with_our_name_is_not_replaced(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "model.json").write_text("somebody's")
    with pytest.raises(ResultsError, match="not empty"):
        prepare(out, kind=KIND, overwrite=False)
    with pytest.raises(ResultsError, match=r"are not replaced"):
        prepare(out, kind=KIND, overwrite=True)
    earlier(tmp_path / "other", figures=("a.png",))
    (tmp_path / "other" / "figures" / "new.png").write_text("mine")
    with pytest.raises(ResultsError, match="did not come from an earlier run"):
        run(tmp_path / "other", figures=("new.png",), overwrite=True)
    assert (tmp_path / "other" / "figures" / "new.png").read_text() == "mine"
    assert (tmp_path / "other" / "model.json").read_text() == "old"


def test_results_of_another_kind_are_not_replaced(tmp_path: Path) -> None:
    earlier(tmp_path / "out")
    with pytest.raises(ResultsError, match="are not replaced"):
        prepare(tmp_path / "out", kind="onebend-other-1", overwrite=True)


def test_results_that_were_edited_are_not_replaced(tmp_path: Path) -> None:
    out = tmp_path / "out"
    earlier(out)
    (out / "model.json").write_text("edited")
    assert changed_files(out) == ["model.json"]
    with pytest.raises(ResultsError, match=r"model\.json there is not as the earlier run left it.*is not replaced"):
        prepare(out, kind=KIND, overwrite=True)
    (out / "model.json").unlink()  # what is gone is in nobody's way
    run(out, overwrite=True)
    summary = json.loads((out / "summary.json").read_text())
    (out / "summary.json").write_text(json.dumps({**summary, "mark": "mine"}))
    with pytest.raises(ResultsError, match=r"summary\.json was changed since"):
        prepare(out, kind=KIND, overwrite=True)


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_failed_run_leaves_the_old_results(tmp_path: Path, overwrite: bool) -> None:
    out = tmp_path / "out"
    if overwrite:
        earlier(out)

    def fails(folder: Path) -> None:
        (folder / "model.json").write_text("half")
        raise OSError(28, "No space left on device", str(folder / "report.html"))

    with (
        pytest.raises(ResultsError, match=r"report\.html: cannot write the results \(No space left"),
        place_at(out, overwrite=overwrite) as place,
    ):
        publish(place, fails)
    assert out.exists() == overwrite
    assert not overwrite or (out / "model.json").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == (["out"] if overwrite else [])
    run(out, overwrite=overwrite)  # and the next run is not in its way
    assert (out / "model.json").read_text() == "new"


def test_a_folder_taken_during_the_work_is_not_overwritten(tmp_path: Path) -> None:
    out = tmp_path / "out"

    def slow(folder: Path) -> None:
        write(folder)
        out.mkdir()
        (out / "mine.txt").write_text("mine")

    with pytest.raises(ResultsError, match="is not empty"), place_at(out) as place:
        publish(place, slow)
    assert (out / "mine.txt").read_text() == "mine"
    whole = unplaced(place)  # the work is not lost
    assert whole is not None
    assert (whole / "model.json").read_text() == "new"


def test_a_run_may_publish_again_with_more(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with place_at(out) as place:
        publish(place, partial(write, figures=()))
        assert files_in(out) == ["model.json", "summary.json"]
        (out / "notes.txt").write_text("mine")
        publish(place, write)
    assert files_in(out) == ["figures/a.png", "model.json", "notes.txt", "summary.json"]


def test_no_results_into_a_recording_nor_onto_a_file(tmp_path: Path) -> None:
    (tmp_path / "recording.toml").write_text("format = 1")
    for out, words in (
        (tmp_path, "this is a recording"),
        (tmp_path / "recording.toml", "this is a file"),
        (tmp_path / "recording.toml" / "out", "cannot be made"),
    ):
        with pytest.raises(ResultsError, match=words):
            prepare(out, kind=KIND, overwrite=True)


def test_results_go_to_the_folder_where_one_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    earlier(out)
    monkeypatch.chdir(out)
    run(Path(), overwrite=True)
    assert Path("model.json").read_text() == "new"


def test_a_link_to_a_folder_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    run(tmp_path / "out")
    assert (tmp_path / "out").is_symlink()
    assert (tmp_path / "disk" / "model.json").read_text() == "new"


def test_one_file_of_a_result_can_be_replaced(tmp_path: Path) -> None:
    out = tmp_path / "out"
    earlier(out)
    assert amend(out / "model.json", b"damped")
    assert (out / "model.json").read_text() == "damped"
    assert changed_files(out) == []
    assert len(own_files(out)) == 4
    (out / "model.json").write_text("edited")
    assert not amend(out / "model.json", b"damped")


def test_what_did_not_move_in_is_moved_in_by_the_next_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, moved = tmp_path / "out", list[Path]()
    earlier(out, figures=("a.png", "b.png"))
    original = Path.replace

    def cut(self: Path, target: Path) -> Path:
        if self.parent.name == "moving" or self.parent.parent.name == "moving":
            moved.append(self)
            if len(moved) == 2:
                raise OSError(5, "Input/output error", str(self))
        return original(self, target)

    monkeypatch.setattr(Path, "replace", cut)
    with pytest.raises(ResultsError, match="Input/output error"):
        run(out, "new", figures=("a.png",), overwrite=True)
    assert (out / "figures" / "a.png").read_text() == "new"
    assert (out / "model.json").read_text() == "old"
    assert changed_files(out) == ["figures/a.png", "figures/b.png"]
    with pytest.raises(ResultsError, match="already holds results"):
        prepare(out, kind=KIND, overwrite=False)
    assert changed_files(out) == []
    assert (out / "model.json").read_text() == "new"
    assert not (out / "figures" / "b.png").exists()
    run(out, "newer", overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_folder_in_the_way_of_a_workplace_is_not_touched(tmp_path: Path) -> None:
    place = prepare(tmp_path / "out", kind=KIND, overwrite=False)
    finish(place)
    place.work.mkdir()
    (place.work / "thesis.tex").write_text("mine")
    with pytest.raises(ResultsError, match="is in the way"):
        prepare(tmp_path / "out", kind=KIND, overwrite=False)
    assert (place.work / "thesis.tex").read_text() == "mine"
