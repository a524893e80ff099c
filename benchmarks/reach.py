"""Forces for goals: the paper's six tasks on the true beams, 10,000 random goals, Algorithm 1 beside, and time.

A random goal is where some force holds the point of a random beam: uniform, tapered 10:1, or uneven; pushed at s = 0.4
to 1, tips turned by up to 120 deg. A force that is found counts as right if load continuation, which knows nothing of
how it was found, brings the point to within 1e-6 m of the goal on a stable branch.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks import reach_true
from benchmarks.reach_goals import Goals, goals, places_under
from benchmarks.truth import parser_of
from onebend.beam.continuation import follow
from onebend.beam.loads import push
from onebend.beam.problem import Resolution, make_problem
from onebend.control.loaded_beam import paper_force
from onebend.control.reach import ReachSettings, reach
from onebend.records import Array, BoolArray

RIGHT = 1e-6  # m
FINE = Resolution(16, 1.0 / 16.0)  # forces without a bound can be a thousand times k / L
EACH = 25  # goals on a beam


@dataclass
class Tally:
    """Counts and times of many goals."""

    right: int = 0
    wrong: int = 0  # claimed, and not so
    refused: int = 0
    iterations: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    @property
    def all(self) -> int:
        return self.right + self.wrong + self.refused


def newton(beams: int, *, seed: int) -> Tally:
    """Every goal from rest, a new search for each."""
    tally = Tally()
    for one in goals(beams, EACH, seed=seed):
        force, claimed = np.zeros_like(one.forces), np.zeros(len(one.forces), dtype=bool)
        for i, goal in enumerate(one.goals):
            began = time.process_time()
            found = reach(one.beam, goal, push_s=one.push_s, point_s=one.point_s)
            tally.seconds.append(time.process_time() - began)
            tally.iterations.append(found.iterations)
            force[i], claimed[i] = found.force, found.converged
        _judge(tally, one, force, claimed)
    return tally


def paper(beams: int, *, seed: int, within: float) -> Tally:
    """The same goals by Algorithm 1; right is what its force does to the exact beam, to `within` m."""
    tally = Tally()
    for one in goals(beams, EACH, seed=seed):
        force, claimed = np.zeros_like(one.forces), np.zeros(len(one.forces), dtype=bool)
        for i, goal in enumerate(one.goals):
            began = time.process_time()
            found, iterations, claimed[i] = paper_force(one.beam, goal, one.push_s, one.point_s)
            tally.seconds.append(time.process_time() - began)
            tally.iterations.append(iterations)
            force[i] = found if claimed[i] else 0.0
        _judge(tally, one, force, claimed, within)
    return tally


def _judge(tally: Tally, one: Goals, force: Array, claimed: BoolArray, within: float = RIGHT) -> None:
    there, stands = places_under(one.beam, force, one.push_s, one.point_s)
    right = claimed & stands & (np.linalg.norm(there - one.goals, axis=1) <= within)
    tally.right += int(np.sum(right))
    tally.wrong += int(np.sum(claimed & ~right))
    tally.refused += int(np.sum(~claimed))


def anywhere(beams: int, *, seed: int) -> tuple[Tally, int]:
    """Goals anywhere in a disc a tenth wider than the beam is long, most of them unreachable; half with a bound.

    `refused` are those said to be unreachable; the second number, how many of them one of 1000 random forces reaches
    to within a thousandth of L after all.
    """
    tally, missed = Tally(), 0
    for i, one in enumerate(goals(beams, 1, seed=seed)):
        rng = np.random.default_rng([seed, i, 1])
        turn, away = rng.uniform(-np.pi, np.pi), 1.1 * one.beam.length * one.point_s * np.sqrt(rng.uniform())
        goal = away * np.array([np.cos(turn), np.sin(turn)])
        largest = 10.0 * float(one.beam.stiffness(np.array([0.5]))[0]) / (one.beam.length * one.push_s**2)
        bound = largest if i % 2 else None
        began = time.process_time()
        found = reach(one.beam, goal, push_s=one.push_s, point_s=one.point_s, settings=ReachSettings(max_force=bound))
        tally.seconds.append(time.process_time() - began)
        if found.converged:
            there, stands = places_under(one.beam, found.force[None], one.push_s, one.point_s, FINE)
            good = bool(stands[0]) and float(np.linalg.norm(there[0] - goal)) < RIGHT
            good = good and (bound is None or float(np.hypot(*found.force)) <= bound * (1.0 + 1e-9))
            tally.right, tally.wrong = tally.right + int(good), tally.wrong + int(not good)
            continue
        tally.refused += 1
        sizes = largest * np.sqrt(rng.uniform(size=1000))
        turns = rng.uniform(-np.pi, np.pi, 1000)
        some = sizes[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
        solved = follow(make_problem(one.beam, push(some, one.push_s), Resolution(12)))
        near = np.linalg.norm(solved.xy(np.array([one.point_s]))[:, 0] - goal, axis=1) < 1e-3 * one.beam.length
        missed += bool(np.any(near & solved.converged & solved.stable))
    return tally, missed


def whole_calls(beams: int, *, seed: int) -> Array:
    """(G, 4) s: `reach` to new goals on beams already met, processor's and wall, and the first calls beside them."""
    rows = []
    for one in goals(beams, EACH, seed=seed):
        spent = []
        for goal in one.goals:
            began, clock = time.process_time(), time.perf_counter()
            reach(one.beam, goal, push_s=one.push_s, point_s=one.point_s)
            spent.append((time.process_time() - began, time.perf_counter() - clock))
        rows += [(*each, *spent[0]) for each in spent[1:]]
    return np.array(rows)


def say_tasks(recordings: Path, count: int, draws: int) -> None:
    known = reach_true.learned(recordings)
    print("The six tasks, each beam learned from its training push alone:\n")
    print(reach_true.table([reach_true.attempt(one, task) for one in known for task in reach_true.TASKS]))
    print(
        "\n| beam | random goals | off on the true beam, median / largest [mm] | in the 95 % ellipse | "
        "drawn beams in it |"
    )
    print("| --- | --- | --- | --- | --- |")
    for one in known:
        some = reach_true.many(one, count, seed=1)
        off = 1e3 * np.array([each.off for each in some])
        inside = sum(each.inside for each in some)
        drawn = sum(reach_true.drawn_inside(each, one, draws, seed=7) for each in some)
        share = 100.0 * drawn / (draws * count)
        print(
            f"| {one.name} | {count} | {np.median(off):.2f} / {off.max():.2f} | {inside} of {count} | {share:.1f} % |"
        )


def say_goals(beams: int, slow: int, wild: int) -> None:
    ours, few = newton(beams, seed=0), newton(slow, seed=1)
    theirs = paper(slow, seed=1, within=2e-3)
    print(
        "\n| random reachable goals | goals | right | claimed but wrong | refused | iterations, median / 99 % | "
        "processor, median [ms] |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name, one in (
        ("Newton on shape and force, from rest", ours),
        ("Newton, the goals of the next row", few),
        ("Algorithm 1, right if within 2 mm", theirs),
    ):
        turns = np.percentile(one.iterations, [50, 99])
        print(
            f"| {name} | {one.all} | {100 * one.right / one.all:.2f} % | {one.wrong} | {one.refused} | "
            f"{turns[0]:.0f} / {turns[1]:.0f} | {1e3 * np.median(one.seconds):.2f} |"
        )
    odd, missed = anywhere(wild, seed=2)
    print(
        f"\nGoals anywhere, with and without a bound on the force: {odd.all}; {odd.right} reached and right, "
        f"{odd.wrong} claimed but wrong, {odd.refused} refused, of which one of 1000 random "
        f"forces reaches {missed} after all. "
        f"A first goal on a beam with its refusal takes {1e3 * np.median(odd.seconds):.0f} ms of a processor (median)."
    )
    calls = 1e3 * whole_calls(20, seed=4)
    median, late = np.median(calls, axis=0), np.percentile(calls, 99, axis=0)
    print(
        f"\nA whole `reach` on a beam it has met before: {median[0]:.2f} ms of a processor, {median[1]:.2f} ms wall "
        f"(medians; 99 %: {late[0]:.1f} and {late[1]:.1f}). The first on a new beam: {median[2]:.1f} ms."
    )


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--beams", type=int, default=400, help=f"random beams with {EACH} goals each")
    asked = parser.parse_args()
    say_tasks(asked.recordings, 20, 50)
    say_goals(asked.beams, 4, 30)


if __name__ == "__main__":
    main()
