"""Which push to make next: candidates ranked by the band on k(s) that would be left after them.

A candidate's information is added to what is known of coefficients and shared nuisances together, so a tag whose place
earlier pushes have shown stays known. The roughness of log k and the sizes of all noise are as the fit found them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.profiles.uncertain import IDENTIFIED_SD, UncertainStiffness, half_width
from onebend.blas import one_blas_thread
from onebend.errors import LearningError, MechanicsError
from onebend.learning.design.candidates import LargestPush, Limits, largest_pushes, same_push
from onebend.learning.design.identifiability import (
    TagDerivatives,
    joint_information,
    mass_of,
    solve_push,
    tag_derivatives,
    with_better_sensor,
)
from onebend.learning.design.instruments import Instruments, PlannedPush
from onebend.learning.design.proposals import PLACES, Plan, Proposal, Quality
from onebend.progress import Progress, Silent, track
from onebend.records import Array


@dataclass(frozen=True)
class PlanSettings:
    """Which pushes are thought of, and how many are told."""

    at_s: tuple[float, ...] = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
    directions_deg: tuple[float, ...] = (60.0, 90.0, 120.0, 150.0, -60.0, -90.0, -120.0, -150.0)
    sizes: tuple[float, ...] = (1.0, 0.6)  # as shares of the largest force that the limits allow
    limits: Limits = field(default_factory=Limits)
    better_sensor: float = 5.0  # times smaller errors of the force sensor thought of
    count: int = 8  # proposals
    apart: float = 0.15  # in s: nearer pushes with the same needs count as one


@dataclass(frozen=True)
class _Thought:
    """A candidate that has been solved."""

    push: PlannedPush
    seen: TagDerivatives
    tip_moves: float
    tip_turns: float
    repeats: bool


@dataclass(frozen=True)
class _Known:
    """What is known of coefficients and shared nuisances, and how the band is read from it."""

    covariance: Array  # (p + N, p + N), the common gain apart
    gain_sd: float
    basis: Array  # (101, p)

    def sd(self) -> Array:
        """(101,) of log k, the gain included."""
        return np.asarray(np.hypot(self._own_sd(), self.gain_sd))

    def quality(self) -> Quality:
        width, known = 2.0 * half_width(self.sd()), self._own_sd() < IDENTIFIED_SD
        worst = int(np.argmax(width))
        to = 1.0 if np.all(known) else round(float(PLACES[max(int(np.argmin(known)) - 1, 0)]), 2)
        share = float(np.mean(known))
        return Quality(float(np.mean(width)), float(width[worst]), float(PLACES[worst]), share, to if known[0] else 0.0)

    def after(self, told: Array) -> _Known:
        """With the information of a push made with the same sensor."""
        return replace(self, covariance=_updated(self.covariance, told))

    def after_other_sensor(self, told: Array, gain_sd: float) -> _Known:
        """With the information of a push made with a sensor of another gain: it tells of today's sensor's gain too."""
        scale = np.append(np.ones(self.basis.shape[1]), np.zeros(len(told) - self.basis.shape[1]))
        if gain_sd > 0.0:
            row = told @ scale
            told = told - np.outer(row, row) / (gain_sd**-2 + scale @ row)
        whole = self.covariance + self.gain_sd**2 * np.outer(scale, scale)
        return _Known(_updated(whole, told), 0.0, self.basis)

    def _own_sd(self) -> Array:
        p = self.basis.shape[1]
        variance = np.einsum("si,ij,sj->s", self.basis, self.covariance[:p, :p], self.basis)
        return np.asarray(np.sqrt(variance))


@one_blas_thread
def plan(
    uncertain: UncertainStiffness,
    beam: Beam,
    bench: Instruments,
    settings: PlanSettings = PlanSettings(),
    *,
    progress: Progress = Silent(),
) -> Plan:
    """Next pushes on a beam whose k(s) is known as `uncertain`: what costs nothing first, then by the mean width of the
    band that they would leave.

    `beam` gives length, rest shape and mass; its stiffness is taken from `uncertain`.

    Raises:
        LearningError: bench and stiffness are not of one fit, or no push is possible within the limits.
    """
    if bench.shared_slope.shape[1] != len(uncertain.mean) or beam.length != bench.length:
        raise LearningError("the bench does not belong to this stiffness: learn the beam again, and plan from that")
    beam = replace(beam, stiffness=uncertain.profile)
    now = _Known(bench.joint(uncertain.covariance), uncertain.gain_sd, uncertain.basis(PLACES))
    found = largest_pushes(beam, bench, settings.at_s, np.deg2rad(settings.directions_deg), settings.limits)
    left_out = _left_out(found)
    thoughts = list(_thoughts(uncertain, beam, bench, found, settings, progress))
    if not thoughts:
        raise LearningError(f"no push is possible within the limits. {' '.join(left_out)}")
    plain = [_propose(t, now, bench) for t in thoughts]
    other = [p for t in thoughts for p in _with_more(t, now, bench, settings)]
    first = min(plain, key=_left)
    after = now.after(_told(thoughts[plain.index(first)], bench))
    second = min((_propose(t, after, bench) for t in thoughts), key=_left)
    ranked = _distinct(sorted([*plain, *other], key=_cost_and_left), settings)
    return Plan(now.quality(), now.sd(), ranked, (first, second), left_out)


def after_push(uncertain: UncertainStiffness, beam: Beam, bench: Instruments, push: PlannedPush) -> UncertainStiffness:
    """What would be known of k(s) after one push with today's sensor; its mean stays where it is.

    Raises:
        MechanicsError: the push has no stable equilibrium.
    """
    beam = replace(beam, stiffness=uncertain.profile)
    solved = solve_push(beam, bench, push)
    tags = np.asarray(bench.tags)
    seen = tag_derivatives(solved, bench, push, mass_of(beam), uncertain.basis(solved.problem.grid.nodes), tags)
    told = joint_information(seen, bench, push, np.arange(len(tags)))
    p = len(uncertain.mean)
    return replace(uncertain, covariance=_updated(bench.joint(uncertain.covariance), told)[:p, :p])


def _thoughts(
    uncertain: UncertainStiffness,
    beam: Beam,
    bench: Instruments,
    found: list[LargestPush],
    settings: PlanSettings,
    progress: Progress,
) -> Iterator[_Thought]:
    """Every candidate within the limits, solved; and the pushes made before, once more."""
    new = [
        PlannedPush(r.at_s, r.direction, share * r.largest) for r in found if not r.why_not for share in settings.sizes
    ]
    again = [p for i, p in enumerate(bench.pushes) if p.largest > 0.0 and p not in bench.pushes[:i]]
    tags, mass = np.concatenate([bench.tags, _gaps(bench)]), mass_of(beam)
    candidates = [(p, True) for p in again] + [(p, False) for p in new if not any(same_push(p, a) for a in again)]
    for candidate, repeats in track(progress, "trying pushes", candidates, len(candidates)):
        try:
            solved = solve_push(beam, bench, candidate)
        except MechanicsError:
            continue  # a push that was made once stands on its way there, but perhaps not when it grows straight
        seen = tag_derivatives(solved, bench, candidate, mass, uncertain.basis(solved.problem.grid.nodes), tags)
        ends = solved.xy(np.ones(1))[[-2, -1], 0]
        turns = solved.angle(np.ones(1))[[-2, -1], 0]
        yield _Thought(candidate, seen, float(np.hypot(*(ends[0] - ends[1]))), float(turns[0] - turns[1]), repeats)


def _gaps(bench: Instruments) -> Array:
    """Where one more tag could go: the middle of each gap from the clamp to the last tag, and the tip if it is bare."""
    edges = np.concatenate([[0.0], np.sort(bench.tags)])
    middles = 0.5 * (edges[1:] + edges[:-1])[np.diff(edges) > 0.1]
    return np.append(middles, 1.0) if edges[-1] < 0.9 else middles


def _told(thought: _Thought, bench: Instruments, more: int | None = None) -> Array:
    own = len(bench.tags)
    chosen = np.arange(own) if more is None else np.append(np.arange(own), more)
    return joint_information(thought.seen, bench, thought.push, chosen)


def _propose(thought: _Thought, now: _Known, bench: Instruments) -> Proposal:
    return _proposal(thought, now, now.after(_told(thought, bench)))


def _with_more(thought: _Thought, now: _Known, bench: Instruments, settings: PlanSettings) -> Iterator[Proposal]:
    """The same push with one more tag, and with a better force sensor."""
    for i in range(len(bench.tags), len(thought.seen.tags)):
        after = now.after(_told(thought, bench, i))
        yield _proposal(thought, now, after, added_tag=float(thought.seen.tags[i]))
    better = with_better_sensor(bench, settings.better_sensor)
    after = now.after_other_sensor(_told(thought, better), better.gain_sd)
    yield _proposal(thought, now, after, better_sensor=settings.better_sensor)


def _proposal(
    thought: _Thought,
    now: _Known,
    after: _Known,
    *,
    added_tag: float | None = None,
    better_sensor: float | None = None,
) -> Proposal:
    return Proposal(
        push=thought.push,
        added_tag=added_tag,
        better_sensor=better_sensor,
        repeats=thought.repeats,
        tip_moves=thought.tip_moves,
        tip_turns=thought.tip_turns,
        before=now.quality(),
        after=after.quality(),
        sd=after.sd(),
    )


def _left(proposal: Proposal) -> float:
    return proposal.after.mean_width


def _cost_and_left(proposal: Proposal) -> tuple[int, float]:
    """What costs nothing first, another force sensor last; within that, by the band that would be left."""
    cost = 2 if proposal.better_sensor is not None else 1 if proposal.added_tag is not None else 0
    return cost, _left(proposal)


def _distinct(ranked: list[Proposal], settings: PlanSettings) -> tuple[Proposal, ...]:
    """The first ones, near-duplicates merged; the best of every kind is among them."""
    kept: list[Proposal] = []
    for one in ranked:
        alike = [k for k in kept if _kind(k) == _kind(one)]
        if all(abs(k.push.at_s - one.push.at_s) >= settings.apart for k in alike):
            kept.append(one)
    best = {_kind(one): i for i, one in reversed(list(enumerate(kept)))}
    others = [i for i in range(len(kept)) if i not in best.values()]
    told = [*sorted(best.values()), *others][: settings.count]
    return tuple(kept[i] for i in sorted(told))


def _kind(one: Proposal) -> str:
    """Pushes that ask the same of the experimenter."""
    if one.added_tag is not None:
        return "tag"
    if one.better_sensor is not None:
        return "sensor"
    return "again" if one.repeats else "new"


def _updated(covariance: Array, told: Array) -> Array:
    """`(C^-1 + H)^-1` without an inverse of C."""
    out = np.linalg.solve(np.eye(len(covariance)) + covariance @ told, covariance)
    return np.asarray(0.5 * (out + out.T))


def _left_out(found: list[LargestPush]) -> tuple[str, ...]:
    """One sentence for each reason why pushes were left out."""
    out = []
    for why in dict.fromkeys(r.why_not for r in found if r.why_not):
        these = [r for r in found if r.why_not == why]
        where = sorted({r.at_s for r in these})
        turned = sorted({round(float(np.rad2deg(r.direction))) for r in these})
        span = f"{where[0]:.2g}" if len(where) == 1 else f"{where[0]:.2g} to {where[-1]:.2g}"
        count = f"{len(these)} pushes" if len(these) > 1 else "1 push"
        out.append(f"{count} at s = {span} in directions {turned} deg left out: {why}.")
    return tuple(out)
