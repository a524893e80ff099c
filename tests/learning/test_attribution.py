"""What an allowance costs, against the textbook's conditional Gaussian written out with the precision."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.learning.allowances import LEFT
from onebend.learning.attribution import FORCE_SCALE, GROUPS, Attribution, attributions, hidden_by
from onebend.learning.linear import FitProblem, Hyperparameters, RecordingNoise, log_k_map
from onebend.learning.normal import JointCovariance
from onebend.learning.optimizer import FitSettings, Optimum
from onebend.learning.parameters import RHO, TAU, Block, Layout
from onebend.learning.posterior import fit
from onebend.records import Array, IntArray
from tests.learning.allowances.allowed_bench import with_everything
from tests.learning.bench import SOFT, forces, observed
from tests.made_up import with_stated

GAIN_SD = 0.02
S = np.linspace(0.1, 0.9, 9)
BLOCKS = with_everything(share=0.1)[1].blocks
FREE = [name for name, of in GROUPS.items() if any(b.name in of and b.start >= 0 for b in BLOCKS)]


def toy(seed: int) -> tuple[FitProblem, Optimum]:
    """A posterior in which everything hangs on everything."""
    one, layout, x = with_everything(share=0.1)
    rng, spline = np.random.default_rng(seed), layout.spline
    one = replace(one, error=replace(one.error, mean=0.01 * rng.standard_normal(one.error.mean.shape)))
    expected = Hyperparameters(spline.variances(TAU, RHO), 1.0, 1.0, 1.0, 1.0, (RecordingNoise(1.0, 1e-4),))
    root = np.eye(layout.size) + 0.3 * rng.standard_normal((layout.size, layout.size)) / np.sqrt(layout.size)
    sd = np.concatenate([b.prior_sd for b in sorted(layout.blocks, key=_start) if b.start >= 0])
    covariance = sd[:, None] * (root @ root.T) * sd
    problem = FitProblem((one,), layout, 0.0, expected)
    return problem, Optimum(
        x, joint(problem, covariance), np.zeros(0), np.zeros((0, 0)), expected, (), (), 0.0, 1, True, ""
    )


def joint(problem: FitProblem, covariance: Array) -> JointCovariance:
    return JointCovariance(problem.layout.shared, (covariance,), problem.layout.parts)


def _start(block: Block) -> int:
    return block.start


def of_log_k(problem: FitProblem) -> Array:
    """(S, P) log k at the places, by all parameters."""
    index, onto = log_k_map(problem)
    out = np.zeros((len(S), problem.layout.size))
    out[:, index] = problem.layout.spline.finer.basis(S) @ onto
    return out


def mean(values: Array, variance: Array) -> float:
    """Weighted by the precision."""
    return float(np.average(values, weights=1.0 / variance))


def columns(layout: Layout, name: str) -> IntArray:
    blocks = [b for b in layout.blocks if b.name in GROUPS[name] and b.start >= 0]
    return np.concatenate([np.arange(b.where.start, b.where.stop) for b in blocks])


@pytest.mark.parametrize(
    "name", [name for name, of in GROUPS.items() if any(b.name in of and b.start >= 0 for b in BLOCKS)]
)
def test_widening_and_shift_are_those_of_the_conditional_gaussian(name: str) -> None:
    problem, optimum = toy(0)
    layout = problem.layout
    found = {a.name: a for a in attributions(problem, optimum, GAIN_SD, S)}[name]
    known = columns(layout, name)
    rest = np.setdiff1d(np.arange(layout.size), known)
    (dense,) = optimum.covariance.pairs
    scale = np.sqrt(np.diag(dense))
    precision = np.linalg.inv(dense / np.outer(scale, scale)) / np.outer(scale, scale)
    left = np.linalg.inv(precision[np.ix_(rest, rest)] * np.outer(scale[rest], scale[rest]))
    left *= np.outer(scale[rest], scale[rest])
    basis = of_log_k(problem)
    before = np.einsum("sp,pq,sq->s", basis, dense, basis) + GAIN_SD**2
    after = np.einsum("sp,pq,sq->s", basis[:, rest], left, basis[:, rest]) + GAIN_SD**2
    assert found.widening == pytest.approx(np.sqrt(mean(before, before) / mean(after, before)), rel=1e-6)
    away = optimum.x[known].copy()
    if name == "error of the force log":
        away -= problem.recordings[0].error.mean.ravel()  # what the rests say of it is known without the fit
    if name == "stretch and shear":
        away += 1.0  # from a beam of no thickness
    moved = left @ precision[np.ix_(rest, known)] @ away  # of the rest, where the known go back to nothing
    shift = basis[:, rest] @ moved - basis[:, known] @ away
    assert found.shift == pytest.approx(np.sqrt(mean(shift**2, before)), rel=1e-6)
    assert found.size == pytest.approx(np.sqrt(mean(shift**2 + before - after, before)), rel=1e-6)
    inside = dense[np.ix_(known, known)]
    chi_squared = float(away @ np.linalg.solve(inside, away))
    assert found.sds == pytest.approx(np.sqrt(max(chi_squared - (len(away) - 1), 0.0)), rel=1e-6)


def test_every_block_but_the_stiffness_is_in_one_group() -> None:
    named = [block for blocks in GROUPS.values() for block in blocks]
    assert len(named) == len(set(named))
    assert {b.name for b in BLOCKS} - set(named) == {"stiffness", "end", "end turn", "zero"}


def test_the_largest_cause_comes_first_then_what_is_left_then_what_every_bench_has() -> None:
    problem, optimum = toy(1)
    found = attributions(problem, optimum, GAIN_SD, S)
    behind = {"error of the force log", "places of the tags", "clamp and origin", "direction of the force"}
    causes = [a for a in found if a.name not in behind | {LEFT}]  # this recording has no clock to be found
    assert [a.size for a in causes] == sorted((a.size for a in causes), reverse=True)
    assert found[len(causes)].name == LEFT
    assert {a.name for a in found[len(causes) + 1 :]} == behind
    assert not any(a.matters for a in found[len(causes) + 1 :])
    assert "mass" not in {a.name for a in found}  # nothing weighs


def test_the_scale_of_the_force_is_one_cause_among_the_others() -> None:
    problem, optimum = toy(1)
    exact = {a.name: a for a in attributions(problem, optimum, 0.0, S)}
    basis = of_log_k(problem)
    (dense,) = optimum.covariance.pairs
    variance = np.einsum("sp,pq,sq->s", basis, dense, basis)
    gain_sd = 0.5 * float(np.sqrt(np.mean(variance)))
    found = {a.name: a for a in attributions(problem, optimum, gain_sd, S)}
    assert set(found) - set(exact) == {FORCE_SCALE}
    scale, whole = found[FORCE_SCALE], variance + gain_sd**2
    assert scale.widening == pytest.approx(np.sqrt(mean(whole, whole) / mean(variance, whole)))
    assert (scale.shift, scale.sds) == (0.0, 0.0)
    assert scale.size == pytest.approx(gain_sd)
    assert scale.sd == pytest.approx(np.sqrt(mean(whole, whole)))


def test_of_two_effects_as_sure_the_open_one_counts_by_what_it_may_do() -> None:
    """Where the most probable value happens to be nothing, the effect may be there all the same."""
    problem, optimum = toy(2)
    (length,) = columns(problem.layout, "length")
    x = optimum.x.copy()
    x[length] = 0.0
    found = {a.name: a for a in attributions(problem, Optimum(**{**vars(optimum), "x": x}), 0.0, S)}["length"]
    assert found.shift == 0.0
    assert found.size > 0.0


def test_what_has_nothing_to_do_with_k_neither_widens_nor_shifts() -> None:
    problem, optimum = toy(0)
    (clamp,) = columns(problem.layout, "clamp that gives")
    alone = optimum.covariance.pairs[0].copy()
    alone[clamp, :], alone[:, clamp] = 0.0, 0.0
    alone[clamp, clamp] = 1e-4
    apart = Optimum(**{**vars(optimum), "covariance": joint(problem, alone)})
    found = {a.name: a for a in attributions(problem, apart, GAIN_SD, S)}["clamp that gives"]
    assert found.widening == pytest.approx(1.0)
    assert found.shift == pytest.approx(0.0, abs=1e-12)
    assert not found.matters


@pytest.mark.parametrize(
    ("widening", "shift", "sds", "matters"),
    [
        (1.2, 0.0, 0.0, True),
        (1.05, 0.0, 0.0, False),
        (1.0, 0.03, 1.0, False),
        (1.0, 0.06, 1.0, True),
        (1.0, 0.03, 3.0, True),
        (1.0, 0.01, 9.0, False),
    ],
)
def test_what_matters(widening: float, shift: float, sds: float, matters: bool) -> None:
    """What the data leave open and what they show without being sure count alike: by the change to be expected."""
    sd = 0.1
    size = np.hypot(shift, sd * np.sqrt(1.0 - 1.0 / widening**2))
    assert Attribution("it", widening, shift, sds, float(size), sd).matters is matters


def test_shift_and_widening_are_those_of_a_fit_without_it() -> None:
    """A push that acts 1.5 mm nearer to the clamp than it is said to, fitted with its place free and frozen."""
    made = observed(SOFT, forces(30), at_s=0.99, noise=(2e-5, 3e-4))
    made = replace(made, push_s=np.ones(30), stated=replace(made.stated, place_sd=2.5e-3))
    settings = FitSettings(allowances=frozenset(), functions=9)
    found, without = fit([made], settings=settings), fit([with_stated(made, place_sd=0.0)], settings=settings)
    s = np.linspace(0.05, 0.85, 41)
    place = {a.name: a for a in attributions(found.problem, found.optimum, 0.0, s)}["place of the push"]
    bands = [one.band(s) for one in (found, without)]
    variance, left = [one.stiffness.log_at(s)[1] ** 2 for one in (found, without)]
    change = np.log(bands[1].k / bands[0].k)
    assert place.shift == pytest.approx(np.sqrt(mean(change**2, variance)), rel=0.1)
    assert place.shift > 0.01
    assert place.widening == pytest.approx(np.sqrt(mean(variance, variance) / mean(left, variance)), rel=0.1)
    assert place.widening > 1.1


def test_what_is_hidden_is_what_the_precision_says() -> None:
    """Known exactly is left out of the precision: the sd with one thing left open inverts what remains of it."""
    problem, optimum = toy(3)
    (dense,) = optimum.covariance.pairs
    rows, precision = of_log_k(problem), np.linalg.inv(dense)
    log_k = log_k_map(problem)[0]
    alone, with_one = hidden_by(problem, optimum, GAIN_SD, S)
    assert set(with_one) == set(FREE)
    for sd, free in [(alone, log_k)] + [
        (with_one[name], np.union1d(log_k, columns(problem.layout, name))) for name in ("rest shape", "length")
    ]:
        left = np.linalg.inv(precision[np.ix_(free, free)])
        expected = np.sqrt(np.einsum("si,ij,sj->s", rows[:, free], left, rows[:, free]) + GAIN_SD**2)
        np.testing.assert_allclose(sd, expected, rtol=1e-6)
    assert all(np.all(one >= alone - 1e-12) for one in with_one.values())
