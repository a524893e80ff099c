"""The (n, m) table and the choice by BIC (19), (20)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from onebend.beam.modal import Modes
from onebend.beam.model import Beam
from onebend.beam.profiles.stiffness import Powers, Profile, Uniform
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.errors import LearningError, MechanicsError
from onebend.learning.model.frames import (
    at_frames,
    distances,
    evenly_spread,
    mass_profile,
    nothing_moves,
    usable_frames,
)
from onebend.learning.model.rest import AtRest
from onebend.learning.outcome import Comparison, Trial
from onebend.learning.paper import regression
from onebend.learning.paper.inverse_kinematics import States, solve_states
from onebend.learning.paper.regression import Family
from onebend.learning.validation import marker_misfit, validate
from onebend.progress import Progress, track
from onebend.records import Array, BoolArray, Observations

Method = Literal["regression", "paper"]
Bic = Literal["textbook", "paper"]
_SNAPS = "the learned beam snaps through under the measured forces"
_FINE = np.linspace(0.0, 1.0, 401)
MOST_FRAMES = 1000  # that a trial is learned from, evenly spread
_SIMULATED = 50  # frames that it is compared in: the markers' RMS of a push is the same in fifty of it as in all


@dataclass(frozen=True)
class RegressionSettings:
    """How k(s) is learned from states and forces."""

    method: Method = "regression"  # "paper": the literal rows of (17), tags' positions only
    family: Family = "gaussians"
    width: float | None = None  # sigma of the Gaussians in units of s; None: the distance of their centres
    bic: Bic = "textbook"
    n: int | None = None  # fix the number of modes
    m: int | None = None  # fix the number of stiffness functions
    most_n: int | None = None  # the paper's z; None: all that the tags can tell, at most 8

    @property
    def with_angles(self) -> bool:
        """Whether the tags' angles are used; the paper had positions only."""
        return self.method != "paper"


@dataclass(frozen=True)
class Candidate:
    """One trial with what it takes to go on from it."""

    trial: Trial
    beam: Beam | None
    solved: Equilibrium | None = None  # where it was simulated


def pairs(settings: RegressionSettings, tags: int) -> list[tuple[int, int]]:
    """All (n, m) to try (20): n in 2..z, m in 2..n. Raises `LearningError` on a fixed n or m that cannot be."""
    limit = (3 if settings.with_angles else 2) * tags
    z = min(limit, 8) if settings.most_n is None else settings.most_n
    if z > limit:
        raise LearningError(f"most_n = {z}, but {tags} tags can tell at most {limit} modes")
    if settings.n is not None and not 2 <= settings.n <= limit:
        raise LearningError(f"n = {settings.n}, but {tags} tags can tell 2 to {limit} modes")
    found = [
        (n, m)
        for n in ([settings.n] if settings.n else range(2, z + 1))
        for m in ([settings.m] if settings.m else range(2, n + 1))
        if m <= n
    ]
    if not found:
        raise LearningError(f"m = {settings.m} stiffness functions need at least as many modes; raise n or lower m")
    return found


def information_criterion(rms: Array, observed: int, parameters: int, kind: Bic) -> float:
    """BIC of a model with markers' `rms` (m,) over `observed` numbers (19).

    textbook: `N ln(RSS / N) + k ln N` with RSS the sum of squares. paper: `ln(sqrt(sum M_i^2)) + 10`, which is what its
    printed Table II follows to rounding (its complexity term is below what the table can show).
    """
    norm = float(np.sqrt(np.sum(rms**2)))
    if kind == "paper":
        return float(np.log(norm) + 10.0)
    mean_square = norm**2 / (2 * len(rms))
    return float(observed * np.log(mean_square) + parameters * np.log(observed))


def table(
    observations: Observations,
    rest: AtRest,
    settings: RegressionSettings,
    progress: Progress,
    most_frames: int = MOST_FRAMES,
) -> list[Candidate]:
    """Every (n, m): learned from at most `most_frames`, simulated and compared in at most 51 of them.

    Raises:
        LearningError: the frames are too few for any.
    """
    observations = _fewer(observations, most_frames)
    frames = usable_frames(observations)
    wanted = pairs(settings, len(observations.marker_s))
    needed = max(n + m for n, m in wanted)
    if still := nothing_moves(observations):
        raise LearningError(f"{observations.source.name}: {still}. Film a push, and let the force log cover it")
    if np.sum(frames) < needed:
        raise LearningError(
            f"{observations.source.name}: {np.sum(frames)} loaded frames, but up to {needed} parameters are to be "
            "found; film a longer push, or fix smaller n and m"
        )
    out: list[Candidate] = []
    states: States | None = None
    compared = _compared(observations, frames)
    near: Equilibrium | None = None
    for n, m in track(progress, "trying (n, m)", wanted, len(wanted)):
        if states is None or states.modes.n != n:
            states = solve_states(observations, n, with_angles=settings.with_angles, rest=rest)
            rows = regression.assemble(observations, states)
        use = frames & states.converged & (states.data >= n)
        out.append(_try(observations, rows, use, compared, near, m, settings))
        near = out[-1].solved or near
    return out


def _fewer(observations: Observations, most: int) -> Observations:
    """At most so many of the usable frames of a film."""
    frames = np.flatnonzero(usable_frames(observations)).astype(np.int64)
    if observations.static or len(frames) <= most:
        return observations
    return at_frames(observations, evenly_spread(frames, most, len(observations.time)))


def _compared(observations: Observations, frames: BoolArray) -> BoolArray:
    """(T,) some fifty of the frames, and that of the largest force: there a beam snaps through first."""
    if observations.static:
        return frames
    rows = np.flatnonzero(frames).astype(np.int64)
    chosen = evenly_spread(rows, _SIMULATED, len(frames))
    chosen[rows[np.argmax(distances(observations.force[rows]))]] = True
    return chosen


def choose(candidates: list[Candidate]) -> int:
    """Index of the lowest BIC. Raises `LearningError` where no trial gave a beam that can stand."""
    bic = np.array([c.trial.bic for c in candidates])
    if not np.any(np.isfinite(bic)):
        worst = "; ".join(f"n={c.trial.n}, m={c.trial.m}: {c.trial.why_out}" for c in candidates[:3])
        raise LearningError(
            f"no (n, m) gave a beam that can be simulated ({worst}; ...). The force or the tags contradict the bending "
            "of a beam: check the force's sign and axes, the clock and the tags' places"
        )
    return int(np.argmin(bic))


def standing(candidates: list[Candidate], observations: Observations, rest: AtRest) -> tuple[int, Comparison]:
    """The trial of the lowest BIC that stands in all frames, and its comparison there; those that do not are put out
    of the running in `candidates`."""
    while True:
        chosen = choose(candidates)
        best = candidates[chosen]
        assert best.beam is not None
        training = validate(best.beam, observations, rest=rest)
        if np.all(np.isfinite(training.predicted)):
            return chosen, training
        candidates[chosen] = replace(best, trial=replace(best.trial, bic=np.inf, why_out=_SNAPS))


def _try(
    observations: Observations,
    rows: regression.MomentRows,
    use: BoolArray,
    compared: BoolArray,
    near: Equilibrium | None,
    m: int,
    settings: RegressionSettings,
) -> Candidate:
    """Learn one (n, m) from the frames `use` (T,), simulate it in those `compared` (T,), compare; `near` as
    that of another trial there."""
    n = rows.states.modes.n
    pi, sigma = regression.basis(settings.family, m, settings.width)
    trial = Trial(n, m, np.full(m, np.nan), np.full(len(observations.marker_s), np.nan), np.inf, np.nan, np.inf)
    if np.sum(use) < n + m:
        return Candidate(replace(trial, why_out=f"only {np.sum(use)} frames show enough tags"), None)
    if settings.method == "paper":
        gamma, condition = regression.literal(rows, use, pi)
    else:
        gamma, condition = regression.weighted(rows, use, pi, force_sd=observations.force_sd)
    stiffness = regression.profile(settings.family, gamma, sigma)
    lowest = float(np.min(stiffness(_FINE)))
    trial = replace(trial, coefficients=gamma, lowest_k=lowest, condition=condition)
    if not lowest > 0.0:
        where = float(_FINE[np.argmin(stiffness(_FINE))])
        return Candidate(replace(trial, why_out=f"k is {lowest:.2g} N m at s = {where:.2f}"), None)
    beam = make_beam(observations, rows.states, stiffness)
    try:
        rms, solved = marker_misfit(beam, observations, compared, rows.states.rest, near)
    except MechanicsError as error:
        return Candidate(replace(trial, why_out=str(error)), None)
    seen = np.isfinite(rms)
    if not seen.any():
        return Candidate(replace(trial, why_out=_SNAPS), beam)
    observed = int(np.sum(np.isfinite(observations.xy[usable_frames(observations)])))
    bic = information_criterion(rms[seen], observed, n + m, settings.bic)
    return Candidate(replace(trial, rms=rms, bic=bic), beam, solved)


def make_beam(observations: Observations, states: States, stiffness: Profile) -> Beam:
    """The learned beam: stiffness, rest curvature and the mass as it is written down."""
    theta0 = states.theta0
    curvature: Profile = Uniform(0.0)
    if np.any(theta0 != 0.0):
        powers = np.linalg.solve(Modes(len(theta0), "powers").to_legendre, theta0)
        curvature = Powers(tuple(float(c) for c in powers))
    return Beam(
        observations.length,
        stiffness,
        rest_curvature=curvature,
        mass_per_length=mass_profile(observations),
        masses=observations.stated.masses,
    )
