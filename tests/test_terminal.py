"""What the terminal shows: bars on a screen, lines on a pipe, k(s) in blocks."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from onebend import cli
from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, UncertainStiffness, Uniform
from onebend.cli import common, screens, screens as plots, screens as tables
from onebend.errors import RecordingError
from onebend.progress import track
from onebend.records import Remark
from onebend.report.overview import overview
from tests import made_up

EXAMPLE = Path(__file__).parents[1] / "examples" / "linear-beam" / "fast"


def console(*, screen: bool = False, width: int = 100) -> Console:
    return Console(file=io.StringIO(), force_terminal=screen, width=width, color_system=None)


def shown(where: Console) -> str:
    assert isinstance(where.file, io.StringIO)
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", where.file.getvalue())


def test_bars_show_count_and_nested_stages() -> None:
    where = console(screen=True)
    with common.Bars(where) as shown_bars:
        for _ in track(shown_bars, "outer [m]", range(3), 3):
            for _ in track(shown_bars, "inner", range(2), None):
                pass
    text = shown(where)
    assert "outer [m]" in text
    assert "3/3" in text
    assert "2/2" in text


def test_bars_close_a_stage_that_is_left_early() -> None:
    where = console(screen=True)
    with common.Bars(where) as shown_bars:
        for i in track(shown_bars, "stage", range(10), 10):
            if i == 4:
                break
        for _ in track(shown_bars, "next", range(3), 3):
            pass
    assert "4/10" in shown(where)
    assert "3/3" in shown(where)


@pytest.mark.parametrize("where_cut", ["inside", "outside"])
def test_an_interrupted_bar_shows_how_far_it_came(where_cut: str) -> None:
    def items() -> Iterator[int]:
        yield from range(4)
        if where_cut == "inside":
            raise KeyboardInterrupt
        yield 4

    where = console(screen=True)

    def work(progress: common.Bars) -> None:
        for i in track(progress, "stage", items(), 192):
            if i == 4:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), common.Bars(where) as shown_bars:
        work(shown_bars)
    assert "4/192" in shown(where).splitlines()[-1]
    assert "192/192" not in shown(where)
    assert "4/4" not in shown(where)


def test_a_pipe_gets_one_line_for_a_long_stage_and_none_for_a_short_one(monkeypatch: pytest.MonkeyPatch) -> None:
    where = console()
    ticks = iter([0.0, 0.1, 10.0, 13.4])
    monkeypatch.setattr(common, "monotonic", lambda: next(ticks))
    with common.Bars(where) as shown_bars:
        for stage in ("short", "long"):
            shown_bars.start(stage, 1)
            shown_bars.advance()
            shown_bars.done()
    assert shown(where) == "long: 3.4 s\n"


def test_a_beam_without_a_band_is_a_line_as_high_as_k(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    where, beam = console(), Beam(0.1, Powers((0.0, 0.08)))
    where.print(plots.band_plot(beam, columns=32, rows=8))
    where.print(tables.band_table(beam, columns=61))
    rows = [line[10:42] for line in shown(where).splitlines()[1:9]]
    lines = [next(7 - i for i, row in enumerate(rows) if row[column] == "━") for column in range(32)]
    np.testing.assert_allclose((np.array(lines) + 0.5) / 8 * 1.05, np.linspace(0, 1, 32), atol=0.51 * 1.05 / 8)
    assert "0.0480" in shown(where)
    assert "95 %" not in shown(where)
    assert "from" not in shown(where)


def test_the_band_is_drawn_around_k_and_the_table_has_both() -> None:
    fit = made_up.posterior()
    where = console()
    where.print(plots.band_plot(fit.stiffness, columns=41, rows=10))
    printed = shown(where).splitlines()[1:11]
    top = float(printed[0].split()[0])
    k = fit.band(np.linspace(0, 1, 41)).k
    lines = [next(9 - i for i, row in enumerate(printed) if row[10 + column] in "━-") for column in range(41)]
    np.testing.assert_allclose(
        (np.array(lines) + 0.5) * top / 10, k, atol=0.55 * top / 10
    )  # half a line, and the rounding of its label
    where = console(width=140)
    where.print(tables.band_table(fit.stiffness, columns=101))
    found = {row.split()[0]: [cell.strip("()") for cell in row.split() if re.match(r"\(?\d", cell)]
             for row in shown(where).splitlines()}  # fmt: skip
    band = fit.band(np.linspace(0.0, 1.0, 11))
    for name, values in (("k", band.k), ("from", band.low), ("to", band.high)):
        np.testing.assert_allclose(np.array(found[name], dtype=float), values, rtol=6e-3)


def blind_tip() -> UncertainStiffness:
    """k = 0.05 N m, known to a tenth but for the last fifth, where it rises to some 70 N m and nothing is known."""
    spline = made_up.posterior().stiffness
    at = np.linspace(0.0, 1.0, len(spline.mean))
    mean = np.log(np.where(at > 0.8, 70.0, 0.05))
    return replace(spline, mean=mean, covariance=np.diag(np.where(at > 0.8, 4.0, 0.0025)), shape=None, doubts=())


def test_the_known_part_sets_the_axis() -> None:
    where = console(width=80)
    where.print(plots.band_plot(blind_tip(), columns=61, rows=8))
    lines = shown(where).splitlines()
    assert "not identified" in lines[0]
    assert 0.05 < float(lines[1].split()[0]) < 0.2  # not 70
    known = [next(i for i, row in enumerate(lines[1:9]) if row[10 + column] == "━") for column in range(30)]
    assert max(known) - min(known) <= 1
    assert min(known) >= 1
    assert all(row[70] not in "━░" for row in lines[1:9])  # what is not known looks otherwise, without colour too


@pytest.mark.parametrize(("width", "height", "most"), [(80, 24, 34), (120, 50, 50)])
def test_the_answer_fits_the_screen(width: int, height: int, most: int) -> None:
    where = Console(file=io.StringIO(), width=width, height=height, color_system=None)
    screens.show_run(where, made_up.findings(1), Path("out"))
    lines = shown(where).splitlines()
    assert len(lines) <= most
    assert max(map(len, lines)) <= width
    assert lines[0].startswith("verdict")
    assert lines[-1] == "report out/report.html"
    numbers = next(line for line in lines if line.startswith(" k [N m]"))
    assert len(numbers.split()) == 3 + (11 if width == 120 else 6)


@pytest.mark.parametrize("markers", [3, 28])
def test_tables_fit_80_columns(markers: int) -> None:
    found = made_up.findings(1)
    ids = 100 + np.arange(markers)
    many = replace(
        found.validations[0], name="a recording's name", tag_id=ids, marker_s=np.linspace(0.1, 1.0, markers),
        rms=np.full(markers, 0.0123), sensor_rms=np.full(markers, 0.0012), likely_rms=np.full(markers, 0.0123),
    )  # fmt: skip
    where = console(width=80)
    where.print(tables.comparison_table([many], "Validation"))
    text = shown(where)
    assert "…" not in text
    assert f"tag {99 + markers}" in text
    assert "12.30" in text


@pytest.mark.parametrize("k", [0.0, -0.1])
def test_plot_of_no_beam_is_empty_not_an_error(k: float) -> None:
    where = console()
    where.print(plots.band_plot(Beam(0.1, Uniform(k))))
    assert "━" not in shown(where)


def test_the_table_of_a_validation() -> None:
    where = console()
    where.print(tables.comparison_table(made_up.findings(2).validations, "Validation"))
    rows = [line.split() for line in shown(where).splitlines() if "tag 1 " in line or "tag 3 " in line]
    assert [row[-3:] for row in rows][:2] == [["1.67", "0.10", "0.20"], ["1.69", "–", "–"]]


def test_nothing_odd_is_said_too() -> None:
    where = console()
    where.print(common.remarks_list([]))
    assert "No remarks." in shown(where)


def copy(folder: Path, *changes: tuple[str, str]) -> Path:
    text = (EXAMPLE / "recording.toml").read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "recording.toml").write_text(text, encoding="utf-8")
    for name in ("video.mp4", "force.csv"):
        (folder / name).symlink_to(EXAMPLE / name)
    return folder


def test_overview_warns_of_clocks_and_cameras_that_cannot_fit(tmp_path: Path) -> None:
    found = overview(copy(tmp_path, ("start_s = 310.9", "start_s = 1000.0"), ("width = 1280", "width = 1920")))
    assert any("do not overlap" in text for text in found.faults)
    assert any("Calibrate at the video's size" in text for text in found.faults)
    assert found.verdict == "`onebend learn` would refuse this recording: 2 errors below"
    sound = overview(EXAMPLE)
    assert not sound.faults
    assert not [remark for remark in sound.remarks if remark.level == "warning"]
    assert sound.verdict == "`onebend learn` can use this recording; nothing looks wrong"
    warned = replace(sound, remarks=(Remark("warning", "odd"), Remark("warning", "odder")))
    assert warned.verdict.endswith("2 warnings below")
    assert "not to be trusted" in replace(warned, remarks=(Remark("warning", "wrong", doubt=True),)).verdict


def test_overview_of_a_broken_video_is_an_error(tmp_path: Path) -> None:
    copy(tmp_path)
    (tmp_path / "video.mp4").unlink()
    (tmp_path / "video.mp4").write_text("not a video")
    with pytest.raises(RecordingError, match=r"video\.mp4"):
        overview(tmp_path)


def test_overview_without_force_or_calibration(tmp_path: Path) -> None:
    copy(tmp_path)
    file = tmp_path / "recording.toml"
    text = file.read_text(encoding="utf-8")
    begin, middle, end = text.index("[camera]"), text.index("[video]"), text.index("[force]")
    file.write_text(text[:begin] + text[middle:end], encoding="utf-8")
    rows = dict(overview(tmp_path).rows)
    assert rows["force"] == "none"
    assert "not calibrated" in rows["camera"]


MARKUP = re.compile(r"\[/?(?:bold|dim|red|yellow|green)[^\]]*\]|\[/\]")
EATEN = re.compile(r"(?<!\\)\[[a-z]")


def test_no_heading_or_help_loses_its_brackets_to_markup() -> None:
    """rich takes [mm] for a tag unless it is escaped."""
    modules = {import_module(place.function.split(":")[0]).__file__ for place in cli.all_commands().values()}
    sources = {*Path(cli.__file__).parent.glob("*.py"), *(Path(str(module)) for module in modules)}
    for source in sorted(sources):
        for text in re.findall(r"(?:title|help)=f?\"([^\"\n]*)\"", source.read_text(encoding="utf-8")):
            assert not EATEN.search(MARKUP.sub("", text)), f"{source.name}: {text}"


def test_no_option_loses_its_brackets_to_markup() -> None:
    """Those that are declared on the fields of settings, too."""
    for name, place in cli.all_commands().items():
        helps = [getattr(one, "help", None) or "" for one in cli.Command(name, place).loaded().params]
        assert [text for text in helps if EATEN.search(text)] == [], name
