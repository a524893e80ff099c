"""What stands around the fit: its start, what it cannot tell apart, what is said of it, one beam in many recordings."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from onebend import pipeline
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.stiffness import Uniform
from onebend.errors import LearningError
from onebend.learning import optimizer
from onebend.learning.frames import nothing_moves
from onebend.learning.optimizer import FitSettings
from onebend.learning.paper import RegressionSettings, regress
from onebend.learning.posterior import LEVEL, Posterior, correlations, fit, tradeoffs, with_level
from onebend.learning.start import start_of
from onebend.learning.validation import mounting, simulate, validate
from onebend.learning.verdict import fit_notices, fitted_rms
from onebend.recording.folder import check_same_beam, read_recording
from onebend.records import Observations, Remark
from onebend.report.sentences import worded
from tests.learning.bench import IDEAL, MARKERS, SOFT, forces, observed
from tests.made_up import with_source, with_stated

NOISE = (2e-5, 1e-3)
EXAMPLE = Path(__file__).parents[2] / "examples" / "linear-beam"


@cache
def made(seed: int = 0) -> Observations:
    return observed(SOFT, forces(30), noise=NOISE, seed=seed)


@cache
def fitted(clamp: float = 3e-3) -> Posterior:
    return fit([made()], 0.02, settings=replace(IDEAL, functions=8, clamp_sd=clamp))


@pytest.mark.parametrize("k", [0.003, 0.03, 3.0])
def test_without_a_regression_the_start_is_the_nearest_uniform_beam(k: float) -> None:
    beam = Beam(0.15, Uniform(k))
    start = start_of([observed(beam, forces(20, most=k / 0.15))], None)
    assert float(start(0.5)) == pytest.approx(k, rel=0.25)  # the grid's step


@pytest.mark.slow
def test_the_start_is_the_regressions_unless_a_uniform_beam_is_nearer() -> None:
    learned = regress(made())
    assert start_of([made()], learned) is learned.beam.stiffness
    soft = replace(learned, beam=Beam(0.15, Uniform(1e-5)))
    assert 0.02 < float(start_of([made()], soft)(0.5)) < 0.08


def test_a_recording_without_a_load_gives_no_start() -> None:
    idle = replace(made(), loaded=np.zeros(30, dtype=bool))
    with pytest.raises(LearningError, match="made: no frame has a load"):
        start_of([idle], None)
    still = replace(made(), xy=np.broadcast_to(made().rest_xy, (30, 3, 2)))
    for one in (still, replace(still, loaded=np.zeros(30, dtype=bool))):
        with pytest.raises(LearningError, match=r"made: nothing moves in the film: .* within 0 mm"):
            start_of([one], None)
        with pytest.raises(LearningError, match="nothing moves"):
            regress(one, RegressionSettings(n=4, m=3))
    assert nothing_moves(replace(still, gravity=np.full((30, 2), -9.81))) == ""
    assert nothing_moves(replace(still, xy=np.add(still.xy, 1e-3))) == ""
    heavy = replace(made(), gravity=np.full((30, 2), -9.81))
    with pytest.raises(LearningError, match="mass_kg"):
        start_of([heavy], None)


@pytest.mark.slow
def test_correlations_are_those_of_draws_from_the_posterior() -> None:
    one = fitted()
    names, found = correlations(one)
    np.testing.assert_allclose(np.diag(found), 1.0)
    draws = np.random.default_rng(1).multivariate_normal(one.mean, one.covariance.pairs[0], 40_000, method="cholesky")
    s = np.linspace(0, 1, 201)
    known = one.band(s).identified
    level = np.mean(draws[:, :8] @ one.layout.spline.basis(s[known]).T, axis=1)
    for name in ("tag 1 along", "made: clamp angle", "made: mean force error y"):
        start = name.split(" error")[0]
        block = next(b for b in one.layout.blocks if any(label.startswith(start) for label in b.labels)
                     or (b.name == "force" and "force" in name))  # fmt: skip
        own = draws[:, block.where]
        over = one.recordings[0].error.weights[: int(np.sum(one.recordings[0].frames))].mean(axis=0)
        value = own[:, 1::2] @ over if block.name == "force" else own[:, block.labels.index(name)]
        assert found[0, names.index(name)] == pytest.approx(np.corrcoef(level, value)[0, 1], abs=0.02), name


def test_tradeoffs_come_strongest_first_and_name_a_quantity_once() -> None:
    found = tradeoffs(fitted(), most=4, least=0.3)
    strength = [abs(one.correlation) for one in found]
    assert found
    assert strength == sorted(strength, reverse=True)
    assert min(strength) >= 0.3
    names = [name for one in found for name in (one.first, one.second)]
    assert len(names) == len(set(names))
    level = with_level(fitted())
    assert {one.first for one in level} == {LEVEL}


@pytest.mark.slow
def test_a_clamp_left_free_is_warned_of() -> None:
    assert worded(fit_notices(fitted())) == ()
    free = fitted(0.05)
    assert [remark.level for remark in worded(fit_notices(free)) if "clamp" in remark.text] == ["warning"]


@pytest.mark.slow
def test_a_search_that_did_not_end_and_a_tag_that_is_elsewhere_are_warned_of() -> None:
    one = fitted()
    unfinished = replace(one, optimum=replace(one.optimum, converged=False))
    assert "did not converge" in worded(fit_notices(unfinished))[0].text
    assert unfinished.doubts == ("the fit did not converge",)
    assert one.doubts == ()
    away = np.array([[0.0, 0.0], [4e-3, 0.0], [0.0, 0.0]])
    moved = replace(made(), xy=np.add(made().xy, away), rest_xy=np.add(made().rest_xy, away))
    texts = [remark.text for remark in worded(fit_notices(fit([moved], 0.02, settings=FitSettings(functions=24))))]
    said = [re.search(r"tag 2 is ([\d.]+) mm off its stated place, along the beam", text) for text in texts]
    assert [float(one[1]) for one in said if one] == pytest.approx([4.0], abs=1.2)  # its neighbours may be off, too


def shifted(posterior: Posterior, by: float) -> Posterior:
    """Of one recording, all measured numbers [m, rad] off by the same."""
    (recording,) = posterior.recordings
    problem = replace(posterior.problem, recordings=(replace(recording, measured=recording.measured + by),))
    return replace(posterior, problem=problem)


def test_a_fit_that_misses_hopelessly_says_so_once_and_nothing_else() -> None:
    one = fitted()
    far = shifted(one, 1.0)
    (said,) = worded(fit_notices(far))
    assert said.level == "warning"
    assert "NOT TO BE TRUSTED" in said.text
    near = shifted(one, 0.003)
    assert [miss.hopeless for miss in (*far.misses, *near.misses)] == [True, False]
    assert not near.band(np.linspace(0, 1, 11)).identified.any()


def test_a_force_that_contradicts_the_bending_puts_k_in_doubt() -> None:
    one = fitted()
    (recording,) = one.recordings
    odd = with_source(
        recording.observations, remarks=(Remark("warning", "turned", doubt=True), Remark("warning", "other"))
    )
    problem = replace(one.problem, recordings=(replace(recording, observations=odd),))
    assert replace(one, problem=problem).doubts == ("the force contradicts the bending",)


def test_a_tag_that_was_never_seen_is_no_hindrance() -> None:
    there = np.arange(3)[:, None] != 1
    seen = replace(
        made(),
        xy=np.where(there, made().xy, np.nan),
        rest_xy=np.where(there, made().rest_xy, np.nan),
        angle=np.where(there[:, 0], made().angle, np.nan),
        rest_angle=np.where(there[:, 0], made().rest_angle, np.nan),
        covariance=np.where(there[..., None], made().covariance, np.nan),
    )
    learned = regress(seen, RegressionSettings(n=4, m=3))
    found = fit([seen], learned.beam.stiffness, settings=replace(IDEAL, functions=8))
    assert found.doubts == ()
    s = np.linspace(0.1, 0.8, 8)
    assert np.all((found.band(s, 0.999).low < SOFT.stiffness(s)) & (SOFT.stiffness(s) < found.band(s, 0.999).high))


def test_the_fit_comes_as_near_to_the_tags_as_their_noise() -> None:
    (rms,) = fitted_rms(fitted())
    np.testing.assert_allclose(rms, NOISE[0] * np.sqrt(2.0), rtol=0.35)


def test_a_curved_beam_is_compared_from_its_own_shape_at_rest() -> None:
    beam = Beam(0.15, SOFT.stiffness, rest_curvature=Uniform(0.3))
    seen = with_stated(observed(beam, forces(10)), rest="unknown")
    [still] = simulate(beam, push(np.zeros((1, 2))))
    np.testing.assert_allclose(mounting(still, seen), 0.0, atol=1e-9)
    assert np.max(validate(beam, seen).rms) < 1e-7
    hidden = replace(seen, rest_xy=np.where(np.arange(3)[:, None] == 1, np.nan, seen.rest_xy))
    assert np.isfinite(mounting(still, hidden)).all()
    assert len(MARKERS) == len(mounting(still, hidden))


def test_recordings_of_two_beams_are_refused_before_any_work() -> None:
    train, fast = read_recording(EXAMPLE / "train"), read_recording(EXAMPLE / "fast")
    check_same_beam([train, fast], jointly=True)
    longer = replace(fast, beam=replace(fast.beam, length=0.2))
    other = replace(fast, tags=replace(fast.tags, on_beam=fast.tags.on_beam[:2]))
    moved = replace(
        fast, tags=replace(fast.tags, on_beam=(replace(fast.tags.on_beam[0], s=0.5), *fast.tags.on_beam[1:]))
    )
    for wrong, words in (
        (longer, "200 mm"), (other, r"\[1, 2\], against"), (moved, "tag 1 is at s = 0.5"), (train, "given twice"),
    ):  # fmt: skip
        with pytest.raises(LearningError, match=words):
            check_same_beam([train, wrong], jointly=True)
    with pytest.raises(LearningError, match="learns from one"):
        check_same_beam([train, fast], jointly=False)


def test_a_regression_that_finds_no_beam_does_not_stop_the_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object, **__: object) -> None:
        raise LearningError("no (n, m) gave a beam")

    monkeypatch.setattr(pipeline, "regress", none)
    monkeypatch.setattr(pipeline, "observe", lambda *_, **__: made())
    run = pipeline.learn(EXAMPLE / "train", fitting=replace(IDEAL, functions=8))
    assert run.learned is None
    assert run.posterior is not None
    assert run.remarks[0].level == "warning"
    assert "no (n, m) gave a beam" in run.remarks[0].text
    s = np.linspace(0.05, 0.9, 30)
    np.testing.assert_allclose(run.beam.stiffness(s), SOFT.stiffness(s), rtol=0.15)
    with pytest.raises(LearningError, match="gave a beam"):
        pipeline.learn(EXAMPLE / "train", fitting=None)


@pytest.mark.slow
def test_one_gain_is_common_to_all_recordings(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = iter([with_stated(made(), gain_sd=0.02), with_stated(with_source(made(1), name="again"), gain_sd=0.05)])
    monkeypatch.setattr(pipeline, "observe", lambda *_, **__: next(seen))
    run = pipeline.learn(EXAMPLE / "train", EXAMPLE / "fast", fitting=replace(IDEAL, functions=8))
    assert run.posterior is not None
    assert run.posterior.stiffness.gain_sd == 0.05
    assert [one.name for one in run.trainings] == ["made", "again"]


def test_what_was_learned_from_is_no_validation(monkeypatch: pytest.MonkeyPatch) -> None:
    train = read_recording(EXAMPLE / "train")
    train = replace(train, beam=replace(train.beam, length=SOFT.length))
    seen = {"train": made(), "copy": with_source(made(), name="copy"), "fast": with_source(made(1), name="other")}
    monkeypatch.setattr(pipeline, "observe", lambda recording, **_: seen[recording.folder.name])
    monkeypatch.setattr(pipeline, "read_recording", lambda folder: replace(train, folder=Path(folder)))
    run = pipeline.learn("train", fitting=replace(IDEAL, functions=8), validate_on=["train", "copy", "fast"])
    assert [one.name for one in run.validations] == ["other"]
    assert [one.source.name for one in run.validation_observations] == ["other"]
    told = [remark.text for remark in run.remarks if "no validation" in remark.text]
    assert ["made" in told[0], "copy" in told[1], len(told)] == [True, True, 2]
    pairs = pipeline.compare(run.beam, ["train", "copy", "fast"], learned_from=run.recordings)
    said = [[one.text for one in worded(found.remarks) if "no validation" in one.text] for found, _ in pairs]
    assert [len(texts) for texts in said] == [1, 1, 0]
    assert "Film another push" in said[0][0]
    assert not any(
        "no validation" in one.text
        for found, _ in pipeline.compare(run.beam, ["train"])
        for one in worded(found.remarks)
    )


def test_equations_that_cannot_be_solved_are_an_error_with_advice(monkeypatch: pytest.MonkeyPatch) -> None:
    def singular(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(optimizer, "laplace_posterior", singular)
    monkeypatch.setattr(pipeline, "observe", lambda *_, **__: made())
    with pytest.raises(LearningError, match=r"made: .*Singular.*--method regression"):
        pipeline.learn(EXAMPLE / "train")


def test_recordings_of_two_beams_that_look_alike_on_paper_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    other = with_source(observed(Beam(0.15, Uniform(0.2)), forces(30), noise=NOISE, seed=4), name="other")
    assert fitted().misses == ()
    seen = iter([made(), other])
    monkeypatch.setattr(pipeline, "observe", lambda *_, **__: next(seen))
    with pytest.raises(LearningError, match=r"do not agree on one beam\. .*misses tag"):
        pipeline.learn(EXAMPLE / "train", EXAMPLE / "fast", fitting=replace(IDEAL, functions=8))
