"""Every figure draws what the records say, with units, also where something is missing."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, UncertainStiffness, Uniform
from onebend.learning.outcome import Comparison
from onebend.learning.prediction import State
from onebend.learning.validation import validate
from onebend.learning.verdict import explained
from onebend.report import figures as curves, figures as recordings, style
from onebend.report.figures import Shown, centreline, largest_push, push_to_show, spread_of_pushes
from onebend.report.overview import overview
from onebend.report.style import BLUE, hue_of, named, png_of
from tests import made_up
from tests.made_up import with_source

HUNG = Path(__file__).parents[3] / "examples" / "hung-weights"
ONE = made_up.comparison()
SEEN = made_up.observations(one=ONE)
FIT = made_up.posterior()
IMAGE = np.full((500, 640, 3), 128, dtype=np.uint8)


def every_figure() -> dict[str, Figure]:
    learned = made_up.learned(ONE)
    shown = Shown(learned.beam, ONE, SEEN)
    assert SEEN.source.view is not None
    return {
        "stiffness": curves.stiffness(
            learned.beam, tags=dict(zip(ONE.tag_id.tolist(), ONE.marker_s.tolist(), strict=True)), push_s=0.8
        ),
        "band": curves.stiffness(FIT.beam, uncertain=FIT.stiffness, regression=learned.beam.stiffness, push_s=0.8),
        "fit": recordings.fit_over_frame(IMAGE, SEEN.source.view, shown),
        "shapes": recordings.shapes(shown),
        "markers": recordings.markers(shown),
        "residuals": recordings.residuals(ONE),
        "force": recordings.force(SEEN),
        "validation": recordings.validation((ONE, made_up.comparison("other"))),
    }


FIGURES = every_figure()
FITTED = explained(FIT)[0]
LOGGED = validate(FIT.beam, FIT.recordings[0].observations)


def test_what_the_fit_explains_runs_through_its_own_tags_and_ends_as_near_as_it_says() -> None:
    one = FITTED.comparison
    residual = 1000 * np.linalg.norm(one.measured - one.predicted, axis=-1)
    np.testing.assert_allclose(1000 * one.rms, np.sqrt(np.nanmean(residual**2, axis=0)), rtol=0.05)
    assert FITTED.line.shape == (len(one.frame), 121, 2)
    sits = FIT.layout.get(FIT.mean, "along"), FIT.layout.get(FIT.mean, "across")
    seen_off = np.asarray(State(FIT.recordings[0], FIT.layout, FIT.mean).allowed("poses"))[: len(one.frame), :, :2]
    away = np.linalg.norm(FITTED.line[:, [40, 80, 120]] - (one.predicted - seen_off), axis=-1)
    assert np.max(away) < 1.01 * np.max(np.hypot(*sits)) + 2e-5  # the tags ride on the line
    slow = FIT.slow[0].force[: len(one.frame)] - FIT.recordings[0].force[: len(one.frame)]
    np.testing.assert_allclose(one.force - FITTED.logged, slow)


def test_the_fit_is_drawn_solid_and_the_logged_force_dashed() -> None:
    seen = FIT.recordings[0].observations
    axes = recordings.shapes(Shown(FIT.beam, LOGGED, seen, FITTED)).axes[0]
    blue = [line for line in axes.lines if line.get_color() == BLUE and line.get_linestyle() == "-"]
    blue = [line for line in blue if np.size(line.get_xdata()) == FITTED.line.shape[1]]
    last = largest_push(FITTED.comparison)
    np.testing.assert_allclose(np.array(blue[-1].get_data(), dtype=float).T, 1000 * FITTED.line[last])
    dashed = [line for line in axes.lines if line.get_linestyle() == "--"]
    assert len(dashed) == len(blue) + 1  # and one for the legend
    above, _ = recordings.markers(Shown(FIT.beam, LOGGED, seen, FITTED)).axes
    solid = [line for line in above.lines if str(line.get_label()).startswith("tag ")]
    np.testing.assert_allclose(np.array(solid[0].get_ydata(), dtype=float), 1000 * FITTED.comparison.predicted[:, 0, 0])
    force = recordings.force(seen, FITTED).axes[0]
    labels = [str(line.get_label()) for line in force.lines]
    assert sum("as fitted" in label for label in labels) == 2


@pytest.mark.parametrize("name", FIGURES)
def test_figure_is_a_picture_with_units_on_its_axes(name: str) -> None:
    figure = FIGURES[name]
    assert png_of(figure).startswith(b"\x89PNG")
    labels = [text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel()) if text]
    bare = ("place along the beam s", "stiffness functions m", "curvature modes n")
    assert all("[" in text or text in bare for text in labels), labels


@pytest.mark.slow
def test_drawing_leaves_no_trace_in_the_callers_settings() -> None:
    before = dict(matplotlib.rcParams)
    png_of(recordings.markers(Shown(made_up.BEAM, ONE, SEEN)))
    assert dict(matplotlib.rcParams) == before


@pytest.mark.slow
def test_the_same_records_give_the_same_bytes() -> None:
    assert png_of(recordings.residuals(ONE)) == png_of(recordings.residuals(ONE))


def test_no_plane_is_drawn_where_one_coordinate_alone_was_read() -> None:
    heights = ONE.measured.copy()
    heights[..., 0] = np.nan
    assert len(recordings.residuals(ONE).axes) == 2
    [over_time] = recordings.residuals(replace(ONE, measured=heights)).axes
    assert "distance" in over_time.get_ylabel()


def test_the_poses_of_a_check_are_lines_with_names() -> None:
    axes = recordings._drawn(overview(HUNG)).axes[0]
    legend = axes.get_legend()
    assert legend is not None
    names = [text.get_text() for text in legend.get_texts()]
    assert names[:6] == ["bare", "20 g tip", "50 g tip", "80 g tip", "50 g middle", "100 g middle"]
    first = np.array(axes.lines[3].get_data(), dtype=float)
    assert first[:, 0].tolist() == [0.0, 0.0]  # each from the clamp
    assert first.shape == (2, 6)


def test_stiffness_curve_is_the_beams() -> None:
    axes = curves.stiffness(made_up.BEAM).axes[0]
    s, k = np.array(axes.lines[0].get_data(), dtype=float)
    np.testing.assert_allclose(k, made_up.BEAM.stiffness(s))


def test_band_is_drawn_where_it_is_and_grey_where_the_data_are_blind() -> None:
    sd = np.array([0.05, 0.05, 0.05, 0.05, 0.05, 1.0])
    knots = np.concatenate([np.zeros(4), [1 / 3, 2 / 3], np.ones(4)])
    uncertain = UncertainStiffness(knots, np.log(np.linspace(0.02, 0.05, 6)), np.diag(sd**2))
    figure = curves.stiffness(Beam(0.1, uncertain.profile), uncertain=uncertain)
    above, below = figure.axes[:2]
    s = np.linspace(0, 1, 401)
    blue, grey = (np.array(line.get_data(), dtype=float) for line in above.lines[:2])
    known = uncertain.band(s).identified
    assert 0 < known.sum() < 401
    np.testing.assert_allclose(blue[1][known], uncertain.profile(s)[known])
    assert np.isnan(blue[1][~known]).all()
    np.testing.assert_allclose(grey[1][~known], uncertain.profile(s)[~known])
    widest = np.array(above.collections[0].get_paths()[0].vertices, dtype=float)
    np.testing.assert_allclose(np.max(widest[:, 1]), np.max(uncertain.band(s).high[known]), rtol=0.1)
    assert below.get_ylabel() == "against k [%]"


@pytest.mark.parametrize("doubts", [(), ("the fit did not converge",)])
def test_one_unidentified_tip_does_not_flatten_the_curve(doubts: tuple[str, ...]) -> None:
    """k grows a hundredfold where nothing tells it; the axes keep to the rest, also where the whole fit is in doubt."""
    knots = np.concatenate([np.zeros(4), np.linspace(0, 1, 11)[1:-1], np.ones(4)])
    mean, sd = np.full(13, np.log(0.05)), np.full(13, 0.03)
    mean[-2:], sd[-3:] = np.log(5.0), 2.0
    uncertain = UncertainStiffness(knots, mean, np.diag(sd**2), doubts=doubts)
    figure = curves.stiffness(Beam(0.1, uncertain.profile), uncertain=uncertain)
    s = np.linspace(0.0, 1.0, 401)
    known = uncertain.best_known(s)
    assert 0.5 < known.mean() < 0.95
    top = float(np.max(uncertain.band(s).high[known]))
    assert 1.15 * top < figure.axes[0].get_ylim()[1] < 1.6 * top
    assert figure.axes[1].get_ylim()[1] < 80.0  # %
    blind = replace(uncertain, covariance=400.0 * np.eye(13) + uncertain.covariance)
    assert 0 < blind.best_known(s).sum() < 401  # the quarter that is known best, where nothing is


def test_stiffness_that_is_no_beam_is_marked() -> None:
    axes = curves.stiffness(Beam(0.1, Powers((0.1, -0.2)))).axes[0]
    assert axes.get_ylim()[0] < -0.1
    legend = axes.get_legend()
    assert legend is not None
    assert "not positive" in legend.get_texts()[0].get_text()


def test_markers_are_where_the_records_say() -> None:
    above, below = recordings.markers(Shown(made_up.BEAM, ONE, SEEN)).axes
    for axes, axis in ((above, 0), (below, 1)):
        drawn = [np.array(line.get_ydata(), dtype=float) for line in axes.lines]
        for i in range(3):
            np.testing.assert_allclose(drawn[2 * i], 1000 * ONE.measured[:, i, axis])
            np.testing.assert_allclose(drawn[2 * i + 1], 1000 * ONE.predicted[:, i, axis])


def test_a_gap_in_time_is_a_gap_in_the_line() -> None:
    time = np.concatenate([ONE.time[:40], ONE.time[40:] + 5.0])
    line = recordings.residuals(replace(ONE, time=time)).axes[0].lines[0]
    y = np.array(line.get_ydata(), dtype=float)
    assert len(y) == len(time) + 1
    assert np.isnan(y[40])


def test_the_frame_shown_is_the_largest_push_with_all_markers() -> None:
    t = largest_push(ONE)
    size = np.linalg.norm(ONE.force, axis=1)
    assert size[t] == size.max()
    assert size[push_to_show(ONE)] >= 0.99 * size.max()
    hidden = replace(ONE, measured=np.where((size > 0.2)[:, None, None], np.nan, ONE.measured))
    assert size[largest_push(hidden)] <= 0.2
    chosen = spread_of_pushes(ONE, 6)
    assert chosen[-1] == t
    np.testing.assert_allclose(size[chosen], np.linspace(0, size.max(), 6), atol=0.01)


def test_the_line_runs_through_the_predicted_markers() -> None:
    line = centreline(made_up.BEAM, ONE, SEEN, 60, places=301)
    assert line is not None
    np.testing.assert_allclose(line[[100, 200, 300]], ONE.predicted[60], atol=1e-9)


def test_a_beam_that_cannot_stand_draws_its_markers_only() -> None:
    beam = Beam(0.15, Uniform(-0.1))
    assert centreline(beam, ONE, SEEN, 60) is None
    assert SEEN.source.view is not None
    png_of(recordings.fit_over_frame(IMAGE, SEEN.source.view, Shown(beam, ONE, SEEN)))
    png_of(recordings.shapes(Shown(beam, ONE, SEEN)))


@pytest.mark.slow
def test_few_frames_unknown_sensor_and_no_force_log() -> None:
    short = made_up.comparison(frames=2)
    png_of(recordings.residuals(short))
    png_of(recordings.markers(Shown(made_up.BEAM, short, SEEN)))
    png_of(recordings.force(with_source(SEEN, clean_force=None)))
    unknown = replace(ONE, rms=np.full(3, np.nan), sensor_rms=np.full(3, np.nan))
    png_of(recordings.validation((unknown,)))


def with_markers(count: int) -> Comparison:
    """`ONE` as so many markers would show it."""
    s = np.linspace(1.0 / count, 1.0, count)
    predicted = made_up.BEAM.equilibrium(ONE.force, ONE.push_s).xy(s)
    measured = predicted + 1e-4 * np.random.default_rng(1).standard_normal(predicted.shape)
    rms = np.sqrt(np.mean(np.sum((measured - predicted) ** 2, axis=-1), axis=0))
    tags = np.arange(1, count + 1)
    return replace(
        ONE, tag_id=tags, marker_s=s, measured=measured, predicted=predicted, rms=rms, sensor_rms=np.full(count, np.nan)
    )


@pytest.mark.parametrize("count", [1, *(pytest.param(n, marks=pytest.mark.slow) for n in (5, 6, 7, 8)), 28])
def test_however_many_markers_all_is_inside_the_picture(count: int) -> None:
    """Matplotlib warns where a legend leaves no room for the axes, and warnings are errors here."""
    one = with_markers(count)
    shown = Shown(made_up.BEAM, one, SEEN)
    for figure in (recordings.shapes(shown), recordings.markers(shown), recordings.residuals(one)):
        png_of(figure)
        legends = [legend for axes in figure.axes if (legend := axes.get_legend()) is not None]
        names = [
            text.get_text() for legend in legends for text in legend.get_texts() if text.get_text().startswith("tag ")
        ]
        assert len(names) == min(count, 7)
        assert names[-1].split(",")[0].split(":")[0].split()[1] == f"{count}"
        for legend in legends:
            box, page = legend.get_window_extent(), figure.bbox.padded(5.0)  # px: a legend has a margin of its own
            assert page.x0 <= box.x0 < box.x1 <= page.x1
            assert page.y0 <= box.y0 < box.y1 <= page.y1
    figure = curves.stiffness(made_up.BEAM, tags=dict(zip(one.tag_id.tolist(), one.marker_s.tolist(), strict=True)))
    assert len([text for text in figure.axes[0].texts if text.get_text().removeprefix("tag ").isdigit()]) == min(
        count, 7
    )


def test_colours_of_many_markers_go_by_their_order() -> None:
    assert [hue_of(i, 7) for i in range(7)] == [hue_of(i) for i in range(7)]
    assert len({hue_of(i, 28) for i in range(28)}) == 28
    assert sorted(named(28))[::6] == [0, 27]
    assert named(3) == {0, 1, 2}


@pytest.mark.slow
def test_a_picture_is_the_one_that_matplotlib_lays_out_by_itself() -> None:
    figures, others = every_figure(), every_figure()
    for name in ("band", "markers", "residuals"):
        figure, again, stream = figures[name], others[name], io.BytesIO()
        with matplotlib.rc_context(style._LOOK):
            packed = {"compress_level": style.PACKING}
            again.savefig(stream, format="png", dpi=style.DPI, metadata={"Software": None}, pil_kwargs=packed)
        assert png_of(figure) == stream.getvalue(), name
