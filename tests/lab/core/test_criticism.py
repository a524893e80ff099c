"""What the fit says of its own model: departures' derivatives, the tests' distribution, and broken recordings."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import kstest

from onebend.beam.continuation import equilibrium
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.stiffness import LogSpline, Powers, Uniform
from onebend.errors import LearningError
from onebend.lab.bench import ForceSensor, PushProfile
from onebend.lab.virtual import VirtualBench, observe_virtual, virtual_recording
from onebend.learning.criticism import (
    AXES,
    UNITS,
    Alternative,
    Criticism,
    Finding,
    LinearisedFit,
    Score,
    Suspect,
    linearised,
    mechanics,
    scores,
)
from onebend.learning.linear import prior, split_off_force
from onebend.learning.posterior import Posterior, fit
from onebend.learning.prediction import predict
from onebend.learning.verdict import cause, fit_notices, what_is_tested
from onebend.records import Array, Observations
from onebend.report.sentences import remedy, worded, words
from onebend.text_files import plain
from tests.lab.core.stretching import stretched
from tests.learning.bench import IDEAL, MARKERS, SOFT, forces, observed

NOISE = (2e-5, 1e-3)
FORCES = forces(30)
MORE = "more in the recording than the fit allows for"
SMALL = replace(IDEAL, functions=8)


@cache
def fitted(seed: int = 0) -> Posterior:
    return fit([observed(SOFT, FORCES, noise=NOISE, seed=seed)], 0.02, settings=SMALL)


@cache
def spline_beam() -> Beam:
    """SOFT as the fit's spline has it."""
    spline, s = fitted().layout.spline, np.linspace(0.0, 1.0, 200)
    c = np.linalg.lstsq(spline.basis(s), np.log(SOFT.stiffness(s)), rcond=None)[0]
    return Beam(SOFT.length, LogSpline(tuple(spline.knots.tolist()), tuple(c.tolist())))


@cache
def patterns() -> dict[str, Array]:
    """Of that beam, tags and clamp as written."""
    one, beam = fitted(), spline_beam()
    x = np.zeros(one.layout.size)
    assert isinstance(beam.stiffness, LogSpline)
    x[:8] = beam.stiffness.coefficients
    return mechanics(predict(one.recordings[0], one.layout, x, None))


def poses(beam: Beam, force: Array = FORCES, at_s: float = 1.0) -> Array:
    shape = beam.equilibrium(force, at_s)
    return np.concatenate([shape.xy(MARKERS), shape.angle(MARKERS)[..., None]], axis=-1)


def otherwise(name: str, h: float) -> Array:
    """(T, m, 3) tags with one thing otherwise by h, each by a solution of its own."""
    beam = spline_beam()
    if name == "length":
        return poses(replace(beam, length=beam.length * (1.0 + h)))
    if name == "push place":
        return poses(beam, at_s=1.0 + h)
    if name == "force direction":
        return poses(beam, FORCES @ np.array([[np.cos(h), np.sin(h)], [-np.sin(h), np.cos(h)]]))
    if name == "axis scale":
        return poses(beam, FORCES * np.array([1.0 + h, 1.0 - h]))
    if name == "force curve":
        return poses(
            beam,
            FORCES * (1.0 + h * np.linalg.norm(FORCES, axis=1, keepdims=True) / np.max(np.linalg.norm(FORCES, axis=1))),
        )
    if name == "clamp":
        return poses(replace(beam, clamp_angle=h))
    if name == "clock":
        return poses(beam, FORCES + h * fitted().recordings[0].rate[: len(FORCES)])
    assert name == "stretch"
    start = equilibrium(beam, push(FORCES))
    xy, angle = stretched(beam, FORCES, 1.0, MARKERS, 1.0 / h, start)
    return np.concatenate([xy, angle[..., None]], axis=-1)


@pytest.mark.parametrize(
    ("name", "h"),
    [
        ("length", 1e-4),
        ("push place", -1e-4),
        ("force direction", 1e-4),
        ("axis scale", 1e-4),
        ("force curve", 1e-4),
        ("clamp", 1e-4),
        ("clock", 1e-4),
        ("stretch", 1e-4),
    ],
)
def test_patterns_are_derivatives_of_the_beam(name: str, h: float) -> None:
    slope = (otherwise(name, h) - poses(spline_beam())) / h
    found = patterns()[name][: len(FORCES), ..., 0]
    np.testing.assert_allclose(found, slope, atol=2e-3 * np.max(np.abs(slope)))


def test_equal_stretch_and_shear_leave_the_angles_and_carry_along_the_force() -> None:
    # Reissner: with E A = G A the strain points along the force, which then has no lever on it.
    both = (patterns()["stretch"] + patterns()["shear"])[: len(FORCES), ..., 0]
    np.testing.assert_allclose(both[..., 2], 0.0, atol=1e-9)
    carried = SOFT.length * MARKERS[None, :, None] * FORCES[:, None, :]
    np.testing.assert_allclose(both[..., :2], carried, atol=1e-9)


def drawn(linear_fit: LinearisedFit, posterior: Posterior, rng: np.random.Generator) -> LinearisedFit:
    """Residuals drawn from the linearised model: parameters, force errors of frames, noise of tags."""
    rows, noise = linear_fit.rows[0], linear_fit.optimum.hyperparameters.noise[0]
    known = linear_fit.known[0]
    before = prior(posterior.problem, posterior.optimum.hyperparameters)
    x: Array = before.times(rng.standard_normal(posterior.layout.size))
    r = rows.slopes.times(x[known])
    r = r + noise.force * np.einsum("frd,fd->fr", rows.a, rng.standard_normal((len(rows.r), 2)))
    r = r + noise.marker * rng.standard_normal(r.shape)
    slope = np.zeros(posterior.layout.size)
    slope[known] = np.einsum("frc,fr->c", rows.slopes.written, split_off_force(rows, r, noise)[0]) / noise.marker**2
    return replace(linear_fit, rows=(replace(rows, r=r),), step=linear_fit.solved.times_covariance(slope))


@pytest.mark.slow
def test_a_score_is_chi_squared_where_the_model_is_right() -> None:
    one, rng = fitted(), np.random.default_rng(4)
    linear_fit = linearised(one.problem, one.optimum)
    suspects = [Suspect("mechanics", name) for name in ("length", "stretch", "weight")]
    tested = [[Alternative(suspect, patterns()[suspect.name]) for suspect in suspects]]
    found = [scores(drawn(linear_fit, one, rng), tested) for _ in range(300)]
    for i, suspect in enumerate(suspects):
        p = np.array([10.0 ** draw[i].log10_p for draw in found])
        assert kstest(p, "uniform").pvalue > 1e-3, suspect


def moved(o: Observations, tag: int, away: tuple[float, float, float]) -> Observations:
    """A tag that sits elsewhere on a beam that hardly turns: by `away` in the clamp's frame at every time."""
    xy, angle, rest_xy, rest_angle = o.xy.copy(), o.angle.copy(), o.rest_xy.copy(), o.rest_angle.copy()
    cos, sin = np.cos(angle[:, tag]), np.sin(angle[:, tag])
    xy[:, tag, 0] += cos * away[0] - sin * away[1]
    xy[:, tag, 1] += sin * away[0] + cos * away[1]
    rest_xy[tag] += away[:2]
    angle[:, tag] += away[2]
    rest_angle[tag] += away[2]
    return replace(o, xy=xy, angle=angle, rest_xy=rest_xy, rest_angle=rest_angle)


def test_a_clean_recording_is_trusted() -> None:
    for seed in range(3):
        critic = fitted(seed).criticism
        assert critic.trusted
        assert critic.widening == 1.0
        assert worded(fit_notices(fitted(seed))) == ()


def test_a_tag_off_its_place_is_named_with_its_distance() -> None:
    one = fit([moved(fitted().recordings[0].observations, 1, (4e-3, 0.0, 0.0))], 0.02, settings=SMALL)
    critic = one.criticism
    assert not critic.trusted
    assert critic.causes[0].score.suspect == Suspect("prior", "along", 1 + 1)
    assert critic.causes[0].score.value[0] == pytest.approx(4e-3, abs=2e-3)
    warned = [remark.text for remark in worded(fit_notices(one)) if MORE in remark.text]
    assert len(warned) == 1
    assert "tag 2 is 4" in warned[0]
    kept = json.loads(json.dumps(plain(critic.as_dict()), allow_nan=False))
    assert kept["trusted"] is False
    assert kept["causes"][0]["name"] == "along"
    assert len(kept["tests"]) == len(critic.findings)


@pytest.mark.slow
def test_a_turned_tag_is_noted_but_does_no_harm() -> None:
    one = fit([moved(fitted().recordings[0].observations, 0, (0.0, 0.0, np.deg2rad(9.0)))], 0.02, settings=SMALL)
    assert one.criticism.trusted
    (remark,) = worded(fit_notices(one))
    assert remark.level == "note"
    assert re.search(r"tag 1 is turned by (8\.9|9) deg", remark.text)


@pytest.mark.slow
def test_clocks_that_run_apart_are_told() -> None:
    beam = Beam(0.15, Powers((0.02, 0.02)), mass_per_length=Uniform(0.3))
    slow = PushProfile(0.4, before=1.0, rise=2.0, hold=0.3, fall=2.0, after=1.0)
    bench = VirtualBench(beam=beam, push=slow, sensor=ForceSensor(rate=100.0, white_sd=0.003), fps=8.0)
    made, lost = virtual_recording(bench, seed=1), 0.3  # s of the log, which are closed up
    time = made.log.time - made.log.time[0]
    kept = (time <= 4.8) | (time > 4.8 + lost)
    late = made.log.time - lost * (time > 4.8)
    seen = observe_virtual(replace(made, log=replace(made.log, time=late[kept], force=made.log.force[kept])))
    first, second, *_ = fit([seen], settings=SMALL).criticism.findings
    assert {first.score.suspect.name, second.score.suspect.name} == {"clock runs", "force curve"}
    assert second.score.log10_p < -4.0


@pytest.mark.slow
def test_a_beam_that_stretches_is_told_with_its_stiffness() -> None:
    o, axial = fitted().recordings[0].observations, 30.0
    rng = np.random.default_rng(2)
    xy, angle = stretched(SOFT, FORCES, 1.0, MARKERS, axial, equilibrium(SOFT, push(FORCES)))
    o = replace(o, xy=xy + NOISE[0] * rng.normal(size=xy.shape), angle=angle + NOISE[1] * rng.normal(size=angle.shape))
    best = fit([o], 0.02, settings=SMALL).criticism.causes[0]
    assert best.score.suspect.name == "stretch"
    assert 1.0 / best.score.value[0] == pytest.approx(axial, rel=0.3)


def test_a_beam_that_hardly_stretches_is_one_that_does_not() -> None:
    start = equilibrium(SOFT, push(FORCES))
    xy, angle = stretched(SOFT, FORCES, 1.0, MARKERS, 1e9, start)
    np.testing.assert_allclose(xy, start.xy(MARKERS), atol=2e-8)
    np.testing.assert_allclose(angle, start.angle(MARKERS), atol=1e-6)


def suspects() -> list[Suspect]:
    out = [Suspect("mechanics", name) for name in UNITS]
    out += [Suspect("prior", name, 1) for name in ("along", "across", "turn", "clamp", "origin", "scale", "clock")]
    out += [Suspect("prior", name) for name in ("mass", "curvature", "rest change")]
    out += [Suspect("change", name, 1, "made") for name in ("creep", "slip", "clock runs", "loose")]
    return [*out, *(Suspect("trend", name, 1, "made") for name in AXES)]


@pytest.mark.parametrize("suspect", suspects(), ids=lambda one: f"{one.kind} {one.name}")
@pytest.mark.parametrize("value", [2e-3, -2e-3])
def test_every_suspect_has_words(suspect: Suspect, value: float) -> None:
    score = Score(suspect, np.full(3, value), np.ones(3), 50.0, -9.0, 1e-3, np.zeros(8))
    finding = Finding(score, 0.1, 2.0)
    found = cause(finding, fitted())
    assert words(found)
    assert remedy(found)
    assert words(what_is_tested(finding, fitted()))
    one = replace(fitted(), criticism=Criticism((finding,)))
    texts = [remark.text for remark in worded(fit_notices(one))]
    assert any(MORE in text for text in texts)
    small = replace(fitted(), criticism=Criticism((replace(finding, sds=0.4),)))
    assert small.criticism.trusted
    assert any(
        remark.level == "note" and "less than half of its sd" in remark.text for remark in worded(fit_notices(small))
    )


@pytest.mark.slow
def test_markers_without_any_noise_are_fitted_to_the_end() -> None:
    one = fit([observed(SOFT, forces(20))], 0.02, settings=replace(IDEAL, functions=24))
    assert one.optimum.converged
    assert one.optimum.steps < 40
    s = np.linspace(0.1, 0.9, 17)
    np.testing.assert_allclose(one.band(s).k, SOFT.stiffness(s), rtol=0.02)


def test_too_few_frames_say_what_to_do() -> None:
    with pytest.raises(LearningError, match=r"3 frames .* at least 5 are needed. Push for longer"):
        fit([observed(SOFT, forces(3), noise=NOISE)], 0.02, settings=IDEAL)
