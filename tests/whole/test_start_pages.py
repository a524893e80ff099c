"""docs/first-beam.md and the pages of docs/start/: every command runs as it is printed; so does the notebook."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import matplotlib.pyplot as plt
import numpy as np
import pypdfium2
import pytest
from typer.testing import CliRunner

from onebend.cli import all_commands, app
from tests.recording import bagged
from tests.recording.test_photos import folder_of as photo_folder
from tests.recording.test_traced_photos import LEVEL, folder_of as traced_folder, painted
from tests.recording.tracked import track_folder
from tests.report.page.browser import BROWSERS

COMMANDS = all_commands()

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
TRAIN, FAST = (ROOT / "examples" / "linear-beam" / name for name in ("train", "fast"))
PAGES = [DOCS / "first-beam.md", *sorted((DOCS / "start").glob("*.md"))]
NOTEBOOK = json.loads((DOCS / "start" / "classroom.ipynb").read_text(encoding="utf-8"))
EVERY = 4  # frames of the film to one picture in the bag
MOST_BYTES = 200_000  # of a picture


def commands(page: Path) -> list[str]:
    """The commands of a page, in order."""
    return re.findall(r"(?m)^    (onebend .+)$", page.read_text(encoding="utf-8"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_has_commands_that_there_are_and_is_linked(page: Path) -> None:
    assert [line.split()[1] for line in commands(page) if line.split()[1] not in COMMANDS] == []
    assert commands(page)
    assert page.relative_to(DOCS).as_posix() in (DOCS / "index.md").read_text(encoding="utf-8")
    assert set(FILLED) == {one.stem for one in PAGES}


def test_pictures_are_small() -> None:
    for name in re.findall(r"\]\((images/[^)]+)\)", PAGES[0].read_text(encoding="utf-8")):
        assert (DOCS / name).stat().st_size < MOST_BYTES, name


def film(here: Path, folder: str) -> None:
    shutil.copytree(TRAIN, here / folder, dirs_exist_ok=True)
    shutil.copytree(FAST, here / "my-second-push", dirs_exist_ok=True)


def bare(here: Path, folder: str) -> None:
    """The page's bodies have no film in the repository: the bundled one has the outline and the tags."""
    film(here, folder)


def bag(here: Path) -> None:
    """The bundled recording as a robot would have recorded it."""
    rows = np.loadtxt(TRAIN / "force.csv", delimiter=",", skiprows=1)
    start = 255.59  # s of the first frame on the log's clock, as the data tell it
    stamp = bagged.START + np.rint(1e9 * (rows[:, 0] - rows[0, 0])).astype(np.int64)
    log = bagged.Log(stamp, np.column_stack([rows[:, 1:3], np.zeros(len(rows))]))
    pictures = []
    with av.open(str(TRAIN / "video.mp4")) as container:
        for i, frame in enumerate(container.decode(video=0)):
            if i % EVERY == 0:
                at = bagged.START + round(1e9 * (start - rows[0, 0] + float(frame.time)))
                pictures.append((at, frame.to_ndarray(format="gray")))
    bagged.write_mcap(here / "run.mcap", log, pictures)


def from_bag(here: Path, folder: str) -> None:
    text = (TRAIN / "recording.toml").read_text(encoding="utf-8")
    head, tail = text.split("[video]")[0], "[push]\nat_s = 1.0\n"
    written = (here / folder / "recording.toml").read_text(encoding="utf-8")
    assert 'topic = "/image"' in written  # filled in by `new`
    assert 'topic = "/wrench"' in written
    sources = (
        '[video]\nfile = "../run.mcap"\ntopic = "/image"\n[force]\nfile = "../run.mcap"\ntopic = "/wrench"\n'
        'axes = ["x", "y"]\nrotation_deg = 0.0\nacts_on = "beam"\n'
    )
    (here / folder / "recording.toml").write_text(head + sources + tail, encoding="utf-8")


def weighed(here: Path, folder: str) -> None:
    if "photos" in folder:
        shutil.rmtree(here / folder)
        photo_folder(here / folder)
    else:
        shutil.copytree(ROOT / "examples" / "hung-weights", here / folder, dirs_exist_ok=True)


def traced(here: Path, folder: str) -> None:
    shutil.rmtree(here / folder)
    traced_folder(here / folder, painted(LEVEL), LEVEL)


def tracked(here: Path, folder: str) -> None:
    track_folder(here / folder)
    shutil.copytree(here / folder, here / "my-second-push", dirs_exist_ok=True)


# What the reader of a page does between `onebend new FOLDER` and the next command.
FILLED: dict[str, Callable[[Path, str], None]] = {
    "first-beam": film,
    "film": film,
    "ros": from_bag,
    "weights": weighed,
    "mocap": tracked,
    "classroom": weighed,
    "without-tags": bare,
    "photo": traced,
}


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_commands_of_a_page_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    if page.stem == "ros":
        bag(tmp_path)
    for line in commands(page):
        words = shlex.split(line)[1:]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, (line, done.output, done.stderr)
        assert "NOT TO BE TRUSTED" not in done.output, line
        if words[0] == "new":
            FILLED[page.stem](tmp_path, words[1])


def cells(kind: str) -> list[str]:
    return ["".join(cell["source"]) for cell in NOTEBOOK["cells"] if cell["cell_type"] == kind]


def test_the_notebook_holds_no_output_and_is_one() -> None:
    assert (NOTEBOOK["nbformat"], NOTEBOOK["nbformat_minor"]) == (4, 5)
    assert len({cell["id"] for cell in NOTEBOOK["cells"]}) == len(NOTEBOOK["cells"])
    for cell in NOTEBOOK["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None
    for number, text in enumerate(cells("code")):
        compile(text, f"cell {number}", "exec")


@pytest.mark.slow
def test_the_notebook_runs_from_top_to_bottom(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(DOCS / "start")
    monkeypatch.setattr(plt, "show", lambda: plt.close("all"))
    there: dict[str, Any] = {}
    for text in cells("code"):
        exec(text, there)
    said = capsys.readouterr().out
    assert "verdict: holds" in said
    one, other = there["uniform"].stiffness(0.0), there["found"].band([1.0]).k[0]
    assert 3.0 * float(one) < float(other)  # what the lesson is about


def test_the_work_sheet_needs_no_other_file_and_fits_one_page(tmp_path: Path) -> None:
    sheet = DOCS / "start" / "worksheet.html"
    assert re.findall(r"(?:src|href)=|url\(|@import|<script", sheet.read_text(encoding="utf-8")) == []
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip("no browser is installed: the sheet is not printed")
    asked = ["--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer"]
    printed = tmp_path / "sheet.pdf"
    call = [browser, *asked, f"--user-data-dir={tmp_path}", f"--print-to-pdf={printed}", sheet.as_uri()]
    subprocess.run(call, check=True, capture_output=True, timeout=120)
    with pypdfium2.PdfDocument(printed) as document:
        assert len(document) == 1
