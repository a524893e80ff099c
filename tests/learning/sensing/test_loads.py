"""A moment besides the force."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from onebend.beam.loads import push, twist
from onebend.cli.screens import show_sensed
from onebend.errors import LearningError
from onebend.learning.sensing.model import bench_at
from onebend.learning.sensing.sense import SenseSettings, sense
from onebend.records import Array, Observations
from onebend.report.control_figures import sensing
from onebend.report.pictures import draw
from onebend.results.sensing import sense_summary, write_forces
from onebend.text_files import to_json
from tests.learning.bench import MARKERS, SOFT, forces, observed
from tests.learning.sensing.drawn import BAND, BEAM, drawn, place_off, shape_of
from tests.learning.sensing.test_sense import exact

MOMENT = SenseSettings(moment=True)


def seen(loads: object) -> Observations:
    """A perfect recording of the soft beam under these."""
    shape = shape_of(SOFT, loads)  # type: ignore[arg-type]
    xy, angle = shape.xy(MARKERS), shape.angle(MARKERS)
    o = exact(observed(SOFT, np.zeros((len(xy), 2)), at_s=0.55, xy=xy, angle=angle))
    return replace(o, covariance=1e-10 * o.covariance, rest_covariance=1e-10 * o.rest_covariance)


def moments(count: int) -> Array:
    return 0.004 * np.sin(np.linspace(0.5, 4.0, count))


def test_noise_free_shapes_give_force_and_moment_back() -> None:
    force, moment = 0.5 * forces(6), moments(6)
    o = seen(push(force, 0.8) + twist(moment, 0.8))
    found = sense(SOFT, o, settings=replace(MOMENT, at_s=0.8))
    assert found.moment is not None
    np.testing.assert_allclose(found.force, force, atol=1e-8)
    np.testing.assert_allclose(found.moment.moment, moment, atol=1e-8)


def test_derivatives_with_a_load_and_its_place_are_those_of_differences() -> None:
    o = observed(SOFT, np.zeros((2, 2)), noise=(3e-5, 1e-3))
    place, load = np.array([0.7, 0.7]), np.array([[0.1, 0.2, 0.003], [-0.1, 0.1, -0.002]])
    bench = bench_at(BEAM, o, BAND, None, tags_as_learned=True, place_sd=5e-4)
    bench, frames = replace(bench, root=np.eye(len(bench.mean))), np.arange(2)

    def poses(load: Array, mean: Array) -> Array:
        now = replace(bench, mean=mean)
        return now.predicted(now.at(frames, place), load, None).pose

    now = bench.predicted(bench.at(frames, place), load, None)
    own, shared = bench.derivatives(now)
    np.testing.assert_allclose(now.by_own(place=True), own, atol=1e-12)
    for i in range(load.shape[1]):
        step = np.zeros(load.shape[1])
        step[i] = 1e-5
        slope = (poses(load + step, bench.mean) - poses(load - step, bench.mean)) / 2e-5
        np.testing.assert_allclose(own[..., i], slope, atol=2e-6)
    np.testing.assert_allclose(own[..., -1], shared[..., bench.columns["place"].start], atol=1e-9)
    for i in range(len(bench.mean)):
        step = np.zeros(len(bench.mean))
        step[i] = 1e-6
        if i == bench.columns["clamp"].start:
            away = [load.copy(), load.copy()]
            for sign, one in zip((1.0, -1.0), away, strict=True):
                cos, sin = np.cos(sign * 1e-6), np.sin(sign * 1e-6)
                one[:, :2] = load[:, :2] @ np.array([[cos, sin], [-sin, cos]])
            slope = (poses(away[0], bench.mean + step) - poses(away[1], bench.mean - step)) / 2e-6
        else:
            slope = (poses(load, bench.mean + step) - poses(load, bench.mean - step)) / 2e-6
        np.testing.assert_allclose(shared[..., i], slope, atol=2e-5)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (SenseSettings(moment_prior=0.1), "no moment is asked for"),
        (SenseSettings(at_s=1.5), "(0, 1]"),
        (SenseSettings(moment=True, place="unknown"), "whose place is said"),
        (SenseSettings(moment=True, moment_prior=0.0), "no moment"),
    ],
)
def test_loads_that_cannot_be_told_are_refused(settings: SenseSettings, words: str) -> None:
    with pytest.raises(LearningError) as error:
        sense(SOFT, observed(SOFT, forces(4)), settings=settings)
    assert words in str(error.value)


@pytest.mark.slow
def test_regions_of_force_and_moment_hold_them() -> None:
    hits: list[bool] = []
    for seed in range(30):
        force, moment = 0.4 * forces(8), moments(8)
        at = 0.8 + place_off(seed)
        o, axes = drawn(seed, push(force, at) + twist(moment, at), at_s=0.8)
        found = sense(BEAM, o, stiffness=BAND, settings=MOMENT)
        assert found.moment is not None
        away = np.column_stack([found.force - force @ axes.T, found.moment.moment - moment])
        whole = np.zeros((8, 3, 3))
        whole[:, :2, :2], whole[:, 2, 2] = found.covariance, found.moment.sd**2
        whole[:, :2, 2] = whole[:, 2, :2] = found.moment.with_force
        hits += [float(a @ np.linalg.solve(c, a)) < 7.815 for a, c in zip(away, whole, strict=True)]
    assert 0.88 < np.mean(hits) < 0.995  # frames of a run are alike: 30 runs tell it to 0.03


def test_files_screen_and_picture_of_a_moment(tmp_path: Path) -> None:
    o, axes = drawn(0, push(forces(4, most=0.2), 0.8) + twist(moments(4), 0.8), at_s=0.8)
    found = sense(BEAM, o, stiffness=BAND, settings=MOMENT)
    assert axes.shape == (2, 2)
    moment = found.moment
    assert moment is not None
    summary = sense_summary("model.json", found)
    to_json(summary)
    write_forces(tmp_path, found)
    assert not draw({"force": lambda: sensing(found)}).failed
    rows = list(csv.DictReader((tmp_path / "force.csv").read_text(encoding="utf-8").splitlines()))
    moments_of = "moment_Nm,moment_sd_Nm,moment_prior_share,fx_moment_covariance_N2m,fy_moment_covariance_N2m"
    assert ",".join(list(rows[0])[-5:]) == moments_of
    np.testing.assert_allclose([float(row["moment_Nm"]) for row in rows], moment.moment, rtol=1e-6)
    stream = io.StringIO()
    show_sensed(Console(file=stream, width=120), found, tmp_path)
    assert "its moment" in stream.getvalue()
