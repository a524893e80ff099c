"""Sheets of tags: rendered from the PDF and measured, read back by the detector, upright."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pypdfium2
import pytest
from matplotlib.figure import Figure
from matplotlib.path import Path as Outline
from typer.testing import CliRunner

from onebend.cli import app
from onebend.errors import MechanicsError, RecordingError
from onebend.lab.sheet import LEFT, PAGES, RULER, Sheet, blank_page, files_of, strip_page, tag_pages
from onebend.recording.entries import FAMILIES, BeamEntry, Recording, TagEntry, TagsEntry
from onebend.records import Array
from tests.lab.printed import black_run, page_image, tags_in

WITHIN = 0.05  # mm
PDF, SVG = Path("t.pdf"), Path("t.svg")


def pdf(pages: Sequence[Figure], title: str) -> bytes:
    return files_of(PDF, pages, title)[PDF]


def fills(page: Figure) -> list[Array]:
    """(n, 2) mm, the corners of each black outline."""
    paths = [patch.get_path() for patch in page.axes[0].patches]
    return [np.asarray(path.vertices)[path.codes != Outline.CLOSEPOLY] for path in paths]


def size_of(page: Figure) -> Array:
    """(2,) mm."""
    return np.asarray(25.4 * page.get_size_inches())


def recording(tags: TagsEntry, length: float = 0.15) -> Recording:
    return Recording(
        folder=Path("r"), name="r", beam=BeamEntry(length=length), tags=tags,
        camera=None, video=None, force=None, push=None, gravity=None,
    )  # fmt: skip


TAGS = TagsEntry(
    size=0.012,
    on_base=(TagEntry(0, 0.0),),
    on_beam=(TagEntry(3, 0.34), TagEntry(17, 2 / 3, math.radians(90.0)), TagEntry(301, 1.0)),
)


@pytest.mark.slow
@pytest.mark.parametrize(("page", "size"), [("a4", 0.012), ("letter", 0.0205)])
def test_tags_are_read_back_upright_and_at_their_size(page: str, size: float) -> None:
    ids = (0, 1, 2, 3, 4, 586)
    (made,) = tag_pages(Sheet(ids, size, page=page))
    width, height = size_of(made)
    assert (width, height) == pytest.approx(PAGES[page])
    image = page_image(pdf([made], "t"))
    assert image.shape == pytest.approx((height * 600 / 25.4, width * 600 / 25.4), abs=1.0)
    found = tags_in(image)
    assert sorted(found) == sorted(ids)
    for tag, fill in zip(ids, fills(made), strict=True):
        (left, top), (right, low) = fill.min(axis=0), fill.max(axis=0)
        assert right - left == pytest.approx(1e3 * size)
        corners = [[left, low], [right, low], [right, top], [left, top]]  # counter-clockwise from the bottom-left
        np.testing.assert_allclose(found[tag], corners, atol=WITHIN)
        first, last = black_run(image, top + 0.4, left - 2.0, right + 2.0)  # through the black rim
        assert last - first == pytest.approx(1e3 * size, abs=WITHIN)


@pytest.mark.slow
@pytest.mark.parametrize(
    "family", [pytest.param(one, marks=() if one == FAMILIES[-1] else pytest.mark.slow) for one in FAMILIES]
)
def test_every_family_prints(family: str) -> None:
    found = tags_in(page_image(pdf(tag_pages(Sheet((0, 5), 0.02, family)), "t")), family)
    assert sorted(found) == [0, 5]
    for corners in found.values():
        assert np.linalg.norm(corners[1] - corners[0]) == pytest.approx(20.0, abs=WITHIN)
        assert corners[1, 0] > corners[0, 0]
        assert corners[0, 1] > corners[3, 1]


def test_rulers_measure_what_they_say() -> None:
    (made,) = tag_pages(Sheet((0,)))
    image = page_image(pdf([made], "t"))
    line = 0.1  # mm, half of what the thick ends add
    first, last = black_run(image, size_of(made)[1] - 14.0, LEFT - 5.0, LEFT + RULER + 5.0)
    assert last - first == pytest.approx(RULER, abs=WITHIN + 2 * line)
    upright, bottom = image.T, size_of(made)[1] - 28.0
    first, last = black_run(upright, 11.0, bottom - RULER - 5.0, bottom + 5.0)
    assert last - first == pytest.approx(RULER, abs=WITHIN + 2 * line)


@pytest.mark.slow
def test_more_tags_than_fit_go_on_to_another_page() -> None:
    sheet = Sheet(tuple(range(60)), 0.03)
    pages = tag_pages(sheet)
    assert len(pages) > 1
    count = [len(fills(page)) for page in pages]
    assert sum(count) == 60
    assert len(set(count[:-1])) <= 1
    for page in pages:
        corners = np.concatenate(fills(page))
        assert corners.min() >= 10.0
        assert np.all(corners.max(axis=0) <= size_of(page) - 10.0)


@pytest.mark.slow
def test_the_white_rim_is_left_free() -> None:
    sheet = Sheet((7,), 0.012, rim=2.0)
    (page,) = tag_pages(sheet)
    (fill,) = fills(page)
    low, high = fill.min(axis=0) - 3.0, fill.max(axis=0) + 3.0
    page.axes[0].patches[0].remove()
    image = page_image(pdf([page], "t"))
    (x0, y0), (x1, y1) = (low * 600 / 25.4).astype(int), (high * 600 / 25.4).astype(int)
    assert np.all(image[y0:y1, x0:x1] == 255)


@pytest.mark.slow
def test_a_strip_has_the_tags_at_their_places_and_turns() -> None:
    page = strip_page(recording(replace(TAGS, on_base=(*TAGS.on_base, TagEntry(9, 0.0)))))  # tag 9: on the bench
    found = tags_in(page_image(pdf([page], "t")))
    centre = {tag: corners.mean(axis=0) for tag, corners in found.items()}
    for entry in TAGS.on_beam:
        np.testing.assert_allclose(centre[entry.id] - centre[0], [150.0 * entry.s, 0.0], atol=WITHIN)
        across = found[entry.id][1] - found[entry.id][0]  # the printed x axis; y runs down the page
        assert math.atan2(-across[1], across[0]) == pytest.approx(entry.turn, abs=0.005)


def test_a_long_beam_lies_across_the_page_and_a_longer_one_is_refused() -> None:
    page = strip_page(recording(TAGS, 0.24))
    width, height = size_of(page)
    assert width > height
    with pytest.raises(MechanicsError, match="does not fit on a4"):
        strip_page(recording(TAGS, 0.27))
    near = replace(TAGS, on_beam=(TagEntry(3, 0.5), TagEntry(4, 0.55)))
    with pytest.raises(MechanicsError, match=r"tags 3 and 4 are 7\.5 mm apart"):
        strip_page(recording(near))


def test_svg_says_the_same_as_the_pdf() -> None:
    (page,) = tag_pages(Sheet((3,), 0.012))
    text = files_of(SVG, [page], "a & b")[SVG].decode()
    assert re.search(r'width="595.27\d*pt" height="841.88\d*pt"', text)
    assert "a &amp; b" in text
    outline = max(re.findall(r'd="([^"]*)"', text), key=len)
    (fill,) = fills(page)
    found = np.array(re.findall(r"([-\d.]+) ([-\d.]+)", outline), dtype=float)
    np.testing.assert_allclose(found * 25.4 / 72.0, fill, atol=1e-4)


@pytest.mark.slow
def test_the_pdf_is_whole_and_the_same_each_time() -> None:
    pages = tag_pages(Sheet(tuple(range(14)), 0.06))
    made = pdf(pages, "t")
    assert made == pdf(pages, "t")
    document = pypdfium2.PdfDocument(made)
    try:
        text = document[0].get_textpage().get_text_range()
    finally:
        document.close()
    assert "Print at 100 %" in text
    assert "size_m = 0.06 * M / 100" in text
    names = [path.name for path in files_of(SVG, pages, "t")]
    assert names == ["t.svg", *(f"t-{i}.svg" for i in range(2, len(pages) + 1))]


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"ids": ()}, "at least one tag"),
        ({"ids": (1, 1)}, "tag 1 is asked for twice"),
        ({"ids": (1,), "size": 0.0}, "size must be positive"),
        ({"ids": (1,), "rim": 0.5}, "at least 1 cell"),
        ({"ids": (1,), "page": "a3"}, "no page is named"),
        ({"ids": (1,), "size": 0.2}, "room for"),
    ],
)
def test_sheets_that_cannot_be_are_refused(asked: dict[str, Any], says: str) -> None:
    with pytest.raises(MechanicsError, match=says):
        tag_pages(Sheet(**asked))


def test_an_id_beyond_the_family_is_refused() -> None:
    with pytest.raises(RecordingError, match="tags 0 to 586"):
        tag_pages(Sheet((587,)))


def test_a_file_of_another_kind_is_refused() -> None:
    with pytest.raises(MechanicsError, match=r"\.pdf or \.svg"):
        files_of("t.png", [blank_page(210.0, 297.0)], "t")


def test_the_command_prints_a_sheet(tmp_path: Path) -> None:
    out = tmp_path / "t.pdf"
    done = CliRunner().invoke(app, ["tags", "--ids", "0-2, 9", "--size-mm", "15", "-o", str(out), "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["ids"] == [0, 1, 2, 9]
    assert sorted(tags_in(page_image(out.read_bytes()))) == [0, 1, 2, 9]
    bundled = Path(__file__).parents[3] / "examples" / "linear-beam" / "train"
    done = CliRunner().invoke(app, ["tags", str(bundled), "-o", str(tmp_path / "b.svg")])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "b-2.svg").is_file()


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ([], "say which tags"),
        (["--ids", "4-0"], "no range of tags"),
        (["--ids", "a"], "no tag and no range"),
        (["--ids", "0", "--family", "tag99"], "not a family"),
        (["nowhere"], "not a folder"),
    ],
)
def test_the_command_refuses_in_one_message(tmp_path: Path, asked: list[str], says: str) -> None:
    done = CliRunner().invoke(app, ["tags", *asked, "-o", str(tmp_path / "t.pdf")])
    assert done.exit_code == 2
    assert says in done.stderr
    assert not list(tmp_path.iterdir())


def test_the_commands_replace_no_file_unasked(tmp_path: Path) -> None:
    mine = {name: tmp_path / name for name in ("t.pdf", "m.json", "b-2.svg")}
    for path in mine.values():
        path.write_text("mine", encoding="utf-8")
    bundled = Path(__file__).parents[3] / "examples" / "linear-beam" / "train"
    for asked in (
        ["tags", "--ids", "0", "-o", str(mine["t.pdf"])],
        ["tags", str(bundled), "-o", str(tmp_path / "b.svg")],
        ["design", "linear", "--model", str(mine["m.json"])],
    ):
        done = CliRunner().invoke(app, asked)
        assert (done.exit_code, "exists already" in done.stderr) == (2, True), asked
    assert {path.read_text(encoding="utf-8") for path in mine.values()} == {"mine"}
    assert sorted(tmp_path.iterdir()) == sorted(mine.values())
    assert CliRunner().invoke(app, ["tags", "--ids", "0", "-o", str(mine["t.pdf"]), "--force"]).exit_code == 0
    assert mine["t.pdf"].read_bytes().startswith(b"%PDF")
