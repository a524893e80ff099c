"""What an allowance costs, against the textbook's conditional Gaussian written out with the precision."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.learning.attribution import GROUPS, Attribution, attributions
from onebend.learning.inference.fit_problem import FitProblem, Hyperparameters, RecordingNoise, log_k_map
from onebend.learning.inference.optimizer import Optimum
from onebend.learning.model.parameters import Block, Layout
from onebend.learning.model.spline import RHO, TAU
from onebend.records import Array, IntArray
from tests.learning.allowances.allowed_bench import with_everything

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
    return problem, Optimum(x, covariance, np.zeros(0), np.zeros((0, 0)), expected, (), 0.0, 1, True, "")


def _start(block: Block) -> int:
    return block.start


def of_log_k(problem: FitProblem) -> Array:
    """(S, P) log k at the places, by all parameters."""
    index, onto = log_k_map(problem)
    out = np.zeros((len(S), problem.layout.size))
    out[:, index] = problem.layout.spline.finer.basis(S) @ onto
    return out


def columns(layout: Layout, name: str) -> IntArray:
    blocks = [b for b in layout.blocks if b.name in GROUPS[name] and b.start >= 0]
    return np.concatenate([np.arange(b.where.start, b.where.stop) for b in blocks])


@pytest.mark.parametrize(
    "name", [name for name, of in GROUPS.items() if any(b.name in of and b.start >= 0 for b in BLOCKS)]
)
def test_widening_and_shift_are_those_of_the_conditional_gaussian(name: str) -> None:
    problem, optimum = toy(0)
    layout = problem.layout
    found = {a.name: a for a in attributions(problem, optimum, S)}[name]
    known = columns(layout, name)
    rest = np.setdiff1d(np.arange(layout.size), known)
    scale = np.sqrt(np.diag(optimum.covariance))
    precision = np.linalg.inv(optimum.covariance / np.outer(scale, scale)) / np.outer(scale, scale)
    left = np.linalg.inv(precision[np.ix_(rest, rest)] * np.outer(scale[rest], scale[rest]))
    left *= np.outer(scale[rest], scale[rest])
    basis = of_log_k(problem)
    before = np.sqrt(np.einsum("sp,pq,sq->s", basis, optimum.covariance, basis))
    after = np.sqrt(np.einsum("sp,pq,sq->s", basis[:, rest], left, basis[:, rest]))
    assert found.widening == pytest.approx(np.median(before / after), rel=1e-6)
    away = optimum.x[known].copy()
    if name == "error of the force log":
        away -= problem.recordings[0].error.mean.ravel()  # what the rests say of it is known without the fit
    if name == "stretch and shear":
        away += 1.0  # from a beam of no thickness
    moved = left @ precision[np.ix_(rest, known)] @ away  # of the rest, where the known go back to nothing
    shift = basis[:, rest] @ moved - basis[:, known] @ away
    assert found.shift == pytest.approx(np.sqrt(np.mean(shift**2)), rel=1e-6)
    inside = optimum.covariance[np.ix_(known, known)]
    chi_squared = float(away @ np.linalg.solve(inside, away))
    assert found.sds == pytest.approx(np.sqrt(max(chi_squared - (len(away) - 1), 0.0)), rel=1e-6)


def test_every_block_but_the_stiffness_is_in_one_group() -> None:
    named = [block for blocks in GROUPS.values() for block in blocks]
    assert len(named) == len(set(named))
    assert {b.name for b in BLOCKS} - set(named) == {"stiffness", "end", "end turn"}


def test_the_largest_effect_comes_first_and_what_is_not_free_is_left_out() -> None:
    problem, optimum = toy(1)
    found = attributions(problem, optimum, S)
    assert [a.worth for a in found] == sorted((a.worth for a in found), reverse=True)
    assert "mass" not in {a.name for a in found}  # nothing weighs


def test_what_has_nothing_to_do_with_k_neither_widens_nor_shifts() -> None:
    problem, optimum = toy(0)
    (clamp,) = columns(problem.layout, "clamp that gives")
    alone = optimum.covariance.copy()
    alone[clamp, :], alone[:, clamp] = 0.0, 0.0
    alone[clamp, clamp] = 1e-4
    apart = Optimum(**{**vars(optimum), "covariance": alone})
    found = {a.name: a for a in attributions(problem, apart, S)}["clamp that gives"]
    assert found.widening == pytest.approx(1.0)
    assert found.shift == pytest.approx(0.0, abs=1e-12)
    assert not found.matters


@pytest.mark.parametrize(
    ("widening", "shift", "sds", "matters"),
    [(1.2, 0.0, 0.0, True), (1.05, 0.1, 1.0, False), (1.05, 0.1, 3.0, True), (1.05, 0.01, 9.0, False)],
)
def test_what_matters(widening: float, shift: float, sds: float, matters: bool) -> None:
    assert Attribution("it", widening, shift, sds).matters is matters
