"""The force from the shape: exact without noise, sure as it says, and silent on what it does not know."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text
from rich.console import Console

from onebend.beam.model import Beam
from onebend.beam.setup import SetUp
from onebend.beam.stiffness import Table, UncertainStiffness
from onebend.cli.screens import show_sensed
from onebend.errors import LearningError
from onebend.learning.sensing.model import bench_at
from onebend.learning.sensing.sense import SenseSettings, sense
from onebend.records import Array, Observations
from onebend.report.control_figures import sensing
from onebend.report.pictures import draw
from onebend.report.sentences import worded
from onebend.report.style import png_of
from onebend.results.sensing import sense_summary, write_forces
from onebend.text_files import to_json
from tests.learning.bench import SOFT, forces, observed

WIDE = SenseSettings(force_prior=1e5)  # N: it says nothing
SOUGHT = SenseSettings(place="unknown")


def few(count: int = 8) -> Array:
    return forces(count)


def exact(o: Observations) -> Observations:
    """A mounting that is known, and hardly any noise."""
    stated = replace(o.stated, placement_sd=1e-7, turn_sd=1e-6, place_sd=0.0, clamp_sd=0.0)
    return replace(o, stated=stated)


@pytest.mark.parametrize("at_s", [1.0, 0.7])
def test_noise_free_shapes_give_the_force_back(at_s: float) -> None:
    force = few()
    found = sense(SOFT, exact(observed(SOFT, force, at_s=at_s)), settings=WIDE)
    np.testing.assert_allclose(found.force, force, atol=1e-8)
    assert found.touched.all()
    assert len(found.contacts) == 1


def test_noise_free_shapes_give_force_and_place_back() -> None:
    force = few(3)
    found = sense(
        SOFT, exact(observed(SOFT, force, at_s=0.63)), settings=SenseSettings(place="unknown", force_prior=30.0)
    )
    np.testing.assert_allclose(found.place, 0.63, atol=1e-3)  # of a noise of 1e-5 m the prior makes this
    assert np.all(np.abs(found.place - 0.63) < found.place_sd)
    assert np.isnan(found.other_place).all()


def test_frames_together_tell_more_than_one_alone_and_agree_with_it() -> None:
    o = observed(SOFT, few(), noise=(5e-5, 2e-3))
    together = sense(SOFT, o)
    alone = sense(SOFT, replace(o, **{name: getattr(o, name)[3:4] for name in IN_TIME}))
    away = alone.force[0] - together.force[3]
    assert away @ np.linalg.solve(alone.covariance[0], away) < 9.0
    assert np.all(np.linalg.eigvalsh(alone.covariance[0] - together.covariance[3]) > 0.0)


IN_TIME = ("time", "frame", "xy", "angle", "covariance", "force", "push_s", "loaded", "gravity")


@pytest.mark.slow
def test_regions_hold_noise_and_the_band_of_k_under_a_push_across_the_beam() -> None:
    knots = np.array([0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0])
    root = 0.05 * np.eye(5) + 0.03
    stiffness = UncertainStiffness(knots, np.full(5, np.log(0.02)), root @ root.T, gain_sd=0.03)
    beam, rng, distances = Beam(0.15, stiffness.profile), np.random.default_rng(0), []
    for true_k in (*stiffness.draw(20, seed=1), *stiffness.draw(20, seed=2)):
        force = forces(5, most=0.25)
        o = observed(Beam(0.15, true_k), force, noise=(3e-5, 1e-3), seed=int(rng.integers(1000)))
        o = replace(o, stated=replace(o.stated, place_sd=0.0, placement_sd=1e-5, turn_sd=1e-4))
        found = sense(beam, o, stiffness=stiffness)
        away = found.force - force
        distances += np.einsum("tc,tcd,td->t", away, np.linalg.inv(found.covariance), away).tolist()
    assert 0.6 < np.mean(distances) / 2.0 < 1.5
    assert np.mean(np.array(distances) < 5.99) > 0.88


def test_without_a_force_the_force_along_the_beam_is_the_prior_and_said_so() -> None:
    found = sense(SOFT, observed(SOFT, np.zeros((4, 2)), noise=(2e-5, 1e-3), seed=4))
    np.testing.assert_allclose(found.prior_share[:, 0], 1.0, atol=0.05)
    assert np.all(found.prior_share[:, 1] < 1e-3)
    assert np.all(np.abs(np.sin(found.weak_angle)) < 0.02)
    assert found.contacts == ()
    assert found.peak is None


def test_the_prior_is_named_where_much_of_a_component_comes_from_it() -> None:
    force = np.column_stack([np.zeros(6), np.full(6, 0.004)])
    found = sense(SOFT, observed(SOFT, force, noise=(2e-5, 1e-3)))
    assert any("comes in good part from the prior" in one.text for one in worded(found.remarks))
    narrow = sense(SOFT, observed(SOFT, force, noise=(2e-5, 1e-3)), settings=SenseSettings(force_prior=0.01))
    assert np.all(narrow.weak_sd <= 0.0101)


@pytest.mark.slow
def test_another_beam_is_noticed_and_the_right_one_is_not() -> None:
    o = observed(SOFT, few(20), noise=(3e-5, 1e-3))
    s = np.linspace(0.0, 1.0, 41)
    other = Beam(0.15, Table(tuple(s.tolist()), tuple((np.asarray(SOFT.stiffness(s)) * (0.6 + 1.2 * s)).tolist())))
    right, wrong = sense(SOFT, o), sense(other, o)
    assert right.misfit is not None
    assert wrong.misfit is not None
    assert right.misfit.ratio < 1.6
    assert wrong.misfit.probability < 1e-4
    assert [one.about for one in worded(wrong.remarks) if one.level == "warning"] == ["sensed misfit"]
    assert not [one for one in worded(right.remarks) if one.level == "warning"]
    assert right.sensor is not None
    assert wrong.sensor is None


def test_a_clamp_that_slipped_after_the_rest_is_noticed() -> None:
    o, turn = observed(SOFT, few(20), noise=(3e-5, 1e-3)), 0.05
    cos, sin = np.cos(turn), np.sin(turn)
    slipped = replace(o, xy=o.xy @ np.array([[cos, sin], [-sin, cos]]), angle=o.angle + turn)
    found = sense(SOFT, slipped)
    assert found.misfit is not None
    assert found.misfit.probability < 1e-4
    assert [one.about for one in worded(found.remarks) if one.level == "warning"] == ["sensed misfit"]


def test_learned_tags_are_taken_over_unless_they_were_put_on_anew() -> None:
    stiffness = UncertainStiffness(np.array([0.0, 0.0, 1.0, 1.0]), np.full(2, np.log(0.02)), 1e-4 * np.eye(2), degree=1)
    beam, sizes = Beam(0.15, stiffness.profile), {"length": 1, "along": 3, "across": 3, "turn": 3, "clamp": 1}
    o, mean = observed(beam, few(), noise=(3e-5, 1e-3)), np.array([0.1, 1e-3, *np.zeros(7), 0.02, 0.004])
    slope, covariance = np.zeros((11, 2)), 1e-10 * np.eye(11)
    places = tuple(o.marker_s.tolist())
    known = SetUp(1.0, (0.0, 1.0), places, 0.01, sizes, mean, slope, covariance, np.ones(11))
    bench = bench_at(SOFT, o, stiffness, known, tags_as_learned=True, place_sd=0.0)
    np.testing.assert_allclose(bench.mean[bench.columns["along"]], mean[1:4])
    np.testing.assert_allclose(bench.mean[bench.columns["turn"]], mean[7:10])
    assert not bench.mean[bench.columns["clamp"]].any()  # it may be another
    np.testing.assert_allclose(np.linalg.norm(bench.root[bench.columns["along"]], axis=1), 1e-5, rtol=1e-6)
    anew = bench_at(SOFT, o, stiffness, known, tags_as_learned=False, place_sd=0.0)
    assert not anew.mean.any()
    clamps = (np.linalg.norm(one.root[one.columns["clamp"]]) for one in (bench, anew))
    assert next(clamps) == pytest.approx(next(clamps))
    np.testing.assert_allclose(np.linalg.norm(anew.root[anew.columns["along"]], axis=1), o.stated.placement_sd)


def test_a_common_factor_on_k_shows_in_the_force_alone() -> None:
    o, s = observed(SOFT, few(20), noise=(1e-5, 1e-3)), np.linspace(0.0, 1.0, 401)
    stiffer = Beam(0.15, Table(tuple(s.tolist()), tuple((1.3 * np.asarray(SOFT.stiffness(s))).tolist())))
    right, wrong = sense(SOFT, o, settings=WIDE), sense(stiffer, o, settings=WIDE)
    np.testing.assert_allclose(wrong.force, 1.3 * right.force, rtol=1e-3, atol=1e-4)
    assert wrong.misfit is not None
    assert wrong.misfit.ratio < 1.6
    assert wrong.against_log is not None
    assert wrong.against_log[0] > 0.02
    assert right.sensor is not None
    assert wrong.sensor is not None
    assert wrong.sensor.gain[0] == pytest.approx(right.sensor.gain[0] / 1.3, rel=0.05)
    assert not right.remarks or "sensed gain" not in {one.about for one in worded(right.remarks)}
    assert "sensed gain" in {one.about for one in worded(wrong.remarks)}


def test_a_missing_tag_and_a_missing_angle_make_it_less_sure() -> None:
    o = observed(SOFT, few(), noise=(3e-5, 1e-3))
    xy, angle = o.xy.copy(), o.angle.copy()
    xy[2, 1:], angle[2] = np.nan, np.nan
    xy[4] = np.nan
    whole, part = sense(SOFT, o), sense(SOFT, replace(o, xy=xy, angle=np.where(np.isnan(xy[..., 0]), np.nan, angle)))
    assert len(part.time) == len(whole.time) - 1
    assert part.weak_sd[2] > 1.2 * whole.weak_sd[2]


@pytest.mark.parametrize(
    ("changed", "settings", "words"),
    [
        ({"length": 0.16}, SenseSettings(), "160 mm"),
        ({"held": np.ones(8, dtype=bool)}, SenseSettings(), "held"),
        ({"push_s": np.full(8, np.nan)}, SenseSettings(), "nobody says where"),
        ({"xy": np.full((8, 3, 2), np.nan)}, SenseSettings(), "no frame shows a tag"),
        ({"gravity": np.full((8, 2), 9.81)}, SenseSettings(), "mass"),
        ({}, SenseSettings(at_s=1.2), "(0, 1]"),
        ({}, SenseSettings(place="unknown", at_s=0.5), "either said or sought"),
        ({}, SenseSettings(force_prior=0.0), "no force"),
        ({}, SenseSettings(at_sd=float("nan")), "finite"),
        ({}, SenseSettings(at_sd=1e300), "let the place be sought"),
        ({}, SenseSettings(force_prior=1e300), "beyond any force on this beam; usual is"),
        ({}, SenseSettings(force_prior=1e-300), "beyond any force on this beam; usual is"),
    ],
)
def test_what_cannot_be_sensed_is_refused(changed: dict[str, object], settings: SenseSettings, words: str) -> None:
    o = replace(observed(SOFT, few()), **changed)  # type: ignore[arg-type]
    with pytest.raises(LearningError) as error:
        sense(SOFT, o, settings=settings)
    assert words in str(error.value)


def test_a_beam_without_stiffness_is_refused_in_words() -> None:
    with pytest.raises(LearningError, match="equations of the force cannot be solved"):
        sense(replace(SOFT, stiffness=Table((0.0, 1.0), (1e-300, 1e-300))), observed(SOFT, few()))


@pytest.mark.slow
def test_the_legend_of_the_force_stands_clear_of_its_title() -> None:
    found = sense(SOFT, observed(SOFT, few(4), noise=(3e-5, 1e-3)), settings=SOUGHT)
    figure = sensing(replace(found, prior_share=np.ones_like(found.prior_share)))
    png_of(figure)
    [legend] = figure.legends
    assert len(legend.get_texts()) == 3
    [title] = figure.findobj(lambda one: isinstance(one, Text) and one.get_text().startswith("Force from the shape"))
    assert not legend.get_window_extent().overlaps(title.get_window_extent())


def test_files_screen_and_picture(tmp_path: Path) -> None:
    found = sense(SOFT, observed(SOFT, few(4), noise=(3e-5, 1e-3)), settings=SOUGHT)
    summary = sense_summary("model.json", found)
    to_json(summary)
    pictures = draw({"force": lambda: sensing(found)})
    write_forces(tmp_path, found)
    pictures.write(tmp_path)
    rows = list(csv.reader((tmp_path / "force.csv").read_text(encoding="utf-8").splitlines()))
    assert ",".join(rows[0]) == (
        "frame,time_s,fx_N,fy_N,fx_sd_N,fy_sd_N,fx_fy_covariance_N2,fx_prior_share,fy_prior_share,"
        "weak_direction_deg,weak_sd_N,strong_sd_N,place_s,place_sd_s,other_place_s,touched,chi2"
    )
    assert {row[0] for row in rows[1:]} == set(map(str, found.frame.tolist()))
    assert {row[15] for row in rows[1:]} <= {"0", "1"}
    np.testing.assert_allclose([float(row[3]) for row in rows[1:]], found.force[:, 1], rtol=1e-6)
    assert (tmp_path / "force.png").exists()
    stream = io.StringIO()
    show_sensed(Console(file=stream, width=100), found, tmp_path)
    assert "largest force" in stream.getvalue()
    assert "weight of the prior" in stream.getvalue()
