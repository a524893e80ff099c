"""What a plan promises against what the fit then gives: the band after one more push, predicted and obtained."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.studies import KINDS as BEAM_KINDS, PLACEMENT, PUSHED, PUSHED_SD, bench_of, fit_from_nothing
from benchmarks.truth import RECORDINGS, parser_of
from onebend.beam.model import Beam
from onebend.beam.stiffness import UncertainStiffness, half_width
from onebend.errors import LearningError, MechanicsError, ObservationError
from onebend.lab.bench import PushProfile
from onebend.lab.virtual import VirtualBench, observe_virtual, virtual_recording
from onebend.learning.design import PLACES, PlanSettings, Proposal, after_push, plan
from onebend.learning.instruments import Instruments, PlannedPush, instruments_of, push_of
from onebend.learning.paper import regress
from onebend.learning.posterior import Posterior, fit
from onebend.recording.beam_frame import MOUNTING_SD
from onebend.recording.observe import observe
from onebend.records import DIRECTION_SD, Array, Observations

BEAMS = ("linear", "quadratic", "cubic")
OTHERS = ("s08", "s06")


@dataclass(frozen=True)
class Row:
    """One more push on one beam; widths are means over s of the 95 % band of log k."""

    beam: str
    added: str
    before: float
    predicted: float
    obtained: float
    worst: tuple[float, float]  # widths at the worst place, predicted and obtained


def widths(known: UncertainStiffness) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """(101,) of the band of log k."""
    return 2.0 * half_width(known.log_at(PLACES)[1])


def rows(recordings: Path = RECORDINGS) -> list[Row]:
    """From the training push alone, what each of the others would add; then both fitted together."""
    out = []
    for beam in BEAMS:
        seen: dict[str, Observations] = {k: observe(recordings / f"{beam}_{k}") for k in ("train", *OTHERS)}
        start = regress(seen["train"]).beam.stiffness
        alone = fit([seen["train"]], start)
        bench = instruments_of(alone)
        for other in OTHERS:
            promised = widths(after_push(alone.stiffness, alone.beam, bench, push_of(seen[other])))
            both = widths(fit([seen["train"], seen[other]], start).stiffness)
            before = float(np.mean(widths(alone.stiffness)))
            worst = (float(np.max(promised)), float(np.max(both)))
            out.append(Row(beam, other, before, float(np.mean(promised)), float(np.mean(both)), worst))
    return out


@dataclass(frozen=True)
class Case:
    """One more push on a virtual beam, really made: mean widths of the band of log k."""

    seed: int
    before: float
    best: tuple[float, float]  # of the first proposal with what there is: promised, delivered
    middle: tuple[float, float]  # of the one in the middle of the ranking


SETTINGS = PlanSettings(at_s=(0.5, 0.75, PUSHED), directions_deg=(60.0, 120.0, -60.0, -120.0), sizes=(1.0, 0.5))


def case(seed: int) -> Case:
    """Push a drawn beam, learn it, plan, make the first proposal and the middle one, and learn from both pushes."""
    bench = bench_of(BEAM_KINDS[seed % len(BEAM_KINDS)], "tags", seed)
    first = observe_virtual(virtual_recording(bench, seed=seed))
    alone = _trusted(fit_from_nothing(first))
    known = instruments_of(alone)
    tried = ranked_pushes(alone.stiffness, alone.beam, known, SETTINGS)
    before = float(np.mean(widths(alone.stiffness)))
    told = []
    for i, rank in enumerate((0, len(tried) // 2)):
        push = tried[rank].push
        promised = tried[rank].after.mean_width
        second = observe_virtual(virtual_recording(_anew(bench, push, seed, i), seed=1000 + 2 * seed + i))
        both = _trusted(fit([first, second], alone.beam.stiffness))
        told.append((promised, float(np.mean(widths(both.stiffness)))))
    return Case(seed, before, told[0], told[1])


def _trusted(found: Posterior) -> Posterior:
    """The fit, where it does not say itself that its band is worth nothing."""
    if found.doubts:
        raise LearningError(f"not to be trusted: {'; '.join(found.doubts)}")
    return found


def ranked_pushes(known: UncertainStiffness, beam: Beam, bench: Instruments, settings: PlanSettings) -> list[Proposal]:
    """All new pushes with what there is, best first: `plan` tells only some of them."""
    found = plan(known, beam, bench, replace(settings, count=10_000, apart=0.0)).proposals
    return [one for one in found if not one.needs and not one.repeats]


def _anew(bench: VirtualBench, push: PlannedPush, seed: int, number: int) -> VirtualBench:
    """The bench for one more push: clamped anew, place and axes of the push off anew, by what is stated of them."""
    rng = np.random.default_rng([seed, number, 31])
    x, y, turn = np.array([PLACEMENT, PLACEMENT, MOUNTING_SD]) * rng.standard_normal(3)
    off, axes = np.array([PUSHED_SD / bench.beam.length, DIRECTION_SD]) * rng.standard_normal(2)
    return replace(
        bench,
        push=PushProfile(push.largest, direction=push.direction, turn=0.0, at_s=push.at_s + float(off)),
        declared=replace(bench.declared, push_s=push.at_s, axes=float(axes)),
        base=(float(x), float(y), float(turn)),
        name=f"{bench.name} {number + 2}",
    )


def virtual(runs: range) -> None:
    """Promise and delivery on virtual beams."""
    print("| seed | before | first proposal: promised / delivered | middle one | removed, promised over delivered |")
    print("| --- " * 5 + "|")
    found = []
    for seed in runs:
        try:
            found.append(case(seed))
        except (LearningError, MechanicsError, ObservationError) as wrong:
            print(f"| {seed} | {wrong} | | | |", flush=True)
            continue
        one = found[-1]
        print(
            f"| {seed} | {one.before:.3f} | {one.best[0]:.3f} / {one.best[1]:.3f} "
            f"| {one.middle[0]:.3f} / {one.middle[1]:.3f} | {removed(one.before, one.best):.2f} |",
            flush=True,
        )
    ratios = np.array([[removed(one.before, pair) for pair in (one.best, one.middle)] for one in found])
    left = np.array([pair[0] / pair[1] for one in found for pair in (one.best, one.middle)])
    better = sum(one.best[1] < one.middle[1] for one in found)
    total = [sum(one.before - one.best[i] for one in found) for i in range(2)]
    print(
        f"\n{len(found)} beams. Removed, promised over delivered: first proposal {spread(ratios[:, 0])}, middle one "
        f"{spread(ratios[:, 1])}; all first proposals together {total[0] / total[1]:.2f}. "
        f"Band left, promised over delivered: {spread(left)}. "
        f"The first proposal left a narrower band than the middle one on {better}."
    )


def removed(before: float, pair: tuple[float, float]) -> float:
    """What the promise removes of the band over what was removed."""
    return (before - pair[0]) / (before - pair[1])


def spread(values: Array) -> str:
    """Median, and the tenth and ninetieth percentiles."""
    low, middle, high = np.percentile(values, (10, 50, 90))
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--virtual", type=int, nargs=2, metavar=("FROM", "TO"), help="seeds of virtual beams instead")
    asked = parser.parse_args()
    if asked.virtual is not None:
        virtual(range(*asked.virtual))
        return
    print("Mean width of the 95 % band of log k; of a push only place, mean direction and largest force are used.\n")
    print("| beam | added to train | before | predicted | obtained | ratio | at worst: predicted / obtained |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for r in rows(asked.recordings):
        print(
            f"| {r.beam} | {r.added} | {r.before:.3f} | {r.predicted:.3f} | {r.obtained:.3f} "
            f"| {r.predicted / r.obtained:.2f} | {r.worst[0]:.2f} / {r.worst[1]:.2f} |"
        )


if __name__ == "__main__":
    main()
