"""Where the fit's own model is wrong: how often it says so, and what its band is worth where it does not."""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.studies import KINDS, MOUNTING, S, bench_of, fit_from_nothing
from onebend.beam.continuation import equilibrium
from onebend.beam.loads import push, weight
from onebend.beam.stiffness import Powers, Uniform, half_width
from onebend.errors import LearningError, MechanicsError, ObservationError
from onebend.lab.designs import RESOLUTION
from onebend.lab.virtual import (
    VirtualBench,
    VirtualRecording,
    from_base,
    observe_virtual,
    tag_poses,
    virtual_recording,
)
from onebend.learning.posterior import Posterior, stiffness_of
from onebend.records import Array, ForceNoise, Observations
from tests.lab.from_truth import observe_from_truth

CLEAN = ("correlated", "bias", "clock", "tags", "everything")  # kinds of errors that the fit allows for
CUTOFF = 4.0  # Hz, of the low-pass where clock and contact are taken from the truth
ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Breakage:
    """A way in which a recording contradicts the model, and what it should be called."""

    make: Callable[[VirtualBench, int], VirtualRecording]
    names: tuple[str, ...]  # suspects that are right


@dataclass(frozen=True)
class Outcome:
    """One fit against its truth."""

    cell: str
    seed: int
    failure: str = ""
    log10_p: float = 0.0  # of the most striking test that bears on k(s)
    trusted: bool = True
    causes: tuple[str, ...] = ()
    inside: float = float("nan")  # share of the identified places of S within the 95 % band
    z: float = float("nan")  # RMS of error / sd there
    marker: float = float("nan")  # noise of the tags, of what was stated


def stretching(bench: VirtualBench, seed: int, *, strain: float) -> VirtualRecording:
    """The largest force, along the beam, would stretch it by `strain`; it does not shear."""
    bending = bench.beam.length * float(np.mean(np.asarray(bench.beam.stiffness(np.linspace(0.0, 1.0, 401)))))
    thickness = float(np.sqrt(12.0 * bending * strain / bench.push.peak))  # EA = 12 EI / h^2
    effects = replace(bench.effects, thickness=thickness, poisson=-0.999)
    return virtual_recording(replace(bench, effects=effects), seed=seed)


def misplaced(bench: VirtualBench, seed: int, *, along: float) -> VirtualRecording:
    """One of the tags sits `along` [m] farther out than written."""
    which = seed % len(bench.tags)
    tags = tuple(replace(t, along=t.along + along * (i == which)) for i, t in enumerate(bench.tags))
    return virtual_recording(replace(bench, tags=tags), seed=seed)


def elsewhere(bench: VirtualBench, seed: int, *, at_s: float) -> VirtualRecording:
    """The push is said to act at `at_s`; it acts at the tip."""
    tip = replace(bench.push, at_s=1.0)
    return virtual_recording(replace(bench, push=tip, declared=replace(bench.declared, push_s=at_s)), seed=seed)


def wrong_length(bench: VirtualBench, seed: int, *, share: float) -> VirtualRecording:
    """The length is said too large by `share`."""
    declared = replace(bench.declared, length=bench.beam.length * (1.0 + share))
    return virtual_recording(replace(bench, declared=declared), seed=seed)


def creeping(bench: VirtualBench, seed: int, *, turn: float) -> VirtualRecording:
    """The rest shape turns by `turn` [rad] at the tip, as the force is summed over time."""
    one = virtual_recording(bench, seed=seed)
    bent = replace(bench, beam=replace(bench.beam, rest_curvature=Powers((turn,))))
    size = np.cumsum(np.linalg.norm(one.force, axis=1))
    return moved(one, (size / size[-1])[:, None, None] * (tag_poses(bent, one.force) - one.pose))


def slipping(bench: VirtualBench, seed: int, *, turn: float) -> VirtualRecording:
    """The clamp turns by `turn` [rad] at the largest force."""
    one = virtual_recording(bench, seed=seed)
    turned = replace(bench, beam=replace(bench.beam, clamp_angle=turn))
    late = one.markers.time > float(np.mean(bench.push.contact))
    return moved(one, late[:, None, None] * (tag_poses(turned, one.force) - one.pose))


def loosening(bench: VirtualBench, seed: int, *, along: float) -> VirtualRecording:
    """A tag shifts by `along` [m] and turns by 1.5 deg at some time during contact."""
    one, which = virtual_recording(bench, seed=seed), seed % len(bench.tags)
    tags = tuple(
        replace(t, along=t.along - along, turn=t.turn + MOUNTING) if i == which else t for i, t in enumerate(bench.tags)
    )
    begin, end = bench.push.contact
    when = begin + (end - begin) * np.random.default_rng([seed, 5]).uniform(0.2, 0.8)
    late = one.markers.time > when
    return moved(one, late[:, None, None] * (tag_poses(replace(bench, tags=tags), one.force) - one.pose))


def heavy(bench: VirtualBench, seed: int, *, share: float) -> VirtualRecording:
    """The beam's weight, of which nothing is written, bends it: `share` of the largest force, across it."""
    one = virtual_recording(bench, seed=seed)
    beam = replace(bench.beam, mass_per_length=Uniform(share * bench.push.peak / 9.81 / bench.beam.length))
    loads = push(one.force, bench.push.at_s) + weight(np.tile([0.0, -9.81], (len(one.force), 1)))
    s = np.array([t.s for t in bench.tags])
    with_it = equilibrium(beam, loads, resolution=RESOLUTION)
    without = equilibrium(bench.beam, push(one.force, bench.push.at_s), resolution=RESOLUTION)
    if not np.all(with_it.converged):
        raise MechanicsError("the virtual beam snaps through under its weight")
    away = [with_it.xy(s) - without.xy(s), (with_it.angle(s) - without.angle(s))[..., None]]
    return moved(one, np.concatenate(away, axis=-1))


BROKEN = {
    "stretch 0.3 %": Breakage(lambda b, i: stretching(b, i, strain=0.003), ("stretch",)),
    "stretch 1 %": Breakage(lambda b, i: stretching(b, i, strain=0.01), ("stretch",)),
    "tag 2 mm off": Breakage(lambda b, i: misplaced(b, i, along=0.002), ("along",)),
    "tag 3 mm off": Breakage(lambda b, i: misplaced(b, i, along=0.003), ("along",)),
    "push said at 0.95": Breakage(lambda b, i: elsewhere(b, i, at_s=0.95), ("push place",)),
    "push said at 0.9": Breakage(lambda b, i: elsewhere(b, i, at_s=0.9), ("push place",)),
    "length 2 % too long": Breakage(lambda b, i: wrong_length(b, i, share=0.02), ("length",)),
    "length 7 % too long": Breakage(lambda b, i: wrong_length(b, i, share=0.07), ("length",)),
    "creep 1 deg": Breakage(lambda b, i: creeping(b, i, turn=float(np.deg2rad(1.0))), ("creep",)),
    "clamp slips 0.2 deg": Breakage(lambda b, i: slipping(b, i, turn=float(np.deg2rad(0.2))), ("slip",)),
    "tag shifts by 0.2 mm": Breakage(lambda b, i: loosening(b, i, along=0.0002), ("loose",)),
    "weight 5 % of the force": Breakage(lambda b, i: heavy(b, i, share=0.05), ("weight", "rest shape")),
}


def moved(one: VirtualRecording, away: Array) -> VirtualRecording:
    """With tags that really were `away` (T, m, 3) from where they are, their noise the same."""
    base = one.bench.base
    change = from_base(one.pose + away, base) - from_base(one.pose, base)
    markers = replace(one.markers, xy=one.markers.xy + change[..., :2], angle=one.markers.angle + change[..., 2])
    return replace(one, markers=markers, pose=one.pose + away)


def quickly(one: VirtualRecording) -> Observations:
    """Observations with clock and contact from the truth, and the sensor's noise as it is."""
    seen, sensor = observe_from_truth(one, cutoff=CUTOFF), one.bench.sensor
    assert seen.source.clean_force is not None
    noise = ForceNoise(sensor.white_sd, sensor.coloured_sd, sensor.coloured_time, 0.1 * sensor.coloured_sd, 0.005)
    return replace(seen, source=replace(seen.source, clean_force=replace(seen.source.clean_force, noise=noise)))


def run(cell: str, seed: int) -> Outcome:
    """Make, observe, fit, compare; the kind of beam goes by the seed."""
    kind = KINDS[seed % len(KINDS)]
    try:
        if cell in BROKEN:
            bench = bench_of(kind, "tags", seed)
            seen = quickly(BROKEN[cell].make(bench, seed))
        else:
            bench = bench_of(kind, cell.split()[1], seed)
            seen = observe_virtual(virtual_recording(bench, seed=seed))
        return compared(fit_from_nothing(seen), np.asarray(bench.beam.stiffness(S)), cell, seed)
    except (LearningError, MechanicsError, ObservationError) as wrong:
        return Outcome(cell, seed, failure=f"{type(wrong).__name__}: {wrong}")


def compared(found: Posterior, truth: Array, cell: str, seed: int) -> Outcome:
    """A fit against k (35,) at S, and what its criticism says."""
    band = stiffness_of(found.problem, found.optimum, found.gain_sd).band(S)  # whatever the verdict
    critic = found.criticism
    known, sd = band.identified, np.log(band.high / band.low) / (2.0 * half_width(1.0))
    inside = (truth > band.low) & (truth < band.high)
    z = np.log(band.k / truth) / sd
    bearing = [f.score.log10_p for f in critic.findings if f.score.suspect.name != "turn"]
    return Outcome(
        cell,
        seed,
        log10_p=min(bearing),
        trusted=critic.trusted,
        causes=tuple(f.score.suspect.name for f in critic.causes),
        inside=float(np.mean(inside[known])) if np.any(known) else np.nan,
        z=float(np.sqrt(np.mean(z[known] ** 2))) if np.any(known) else np.nan,
        marker=found.optimum.hyperparameters.noise[0].marker,
    )


def kept() -> Path:
    """The file that runs of this very code are added to."""
    digest = hashlib.sha256()
    for source in sorted([*(ROOT / "src").rglob("*.py"), ROOT / "benchmarks" / "studies.py", Path(__file__)]):
        digest.update(source.read_bytes())
    return ROOT / "out" / "benchmarks" / f"broken-{digest.hexdigest()[:12]}.jsonl"


def study(wanted: Sequence[tuple[str, int]], path: Path) -> dict[tuple[str, int], Outcome]:
    """Do what `path` does not hold yet, and add it there."""
    done: dict[tuple[str, int], Outcome] = {}
    if path.is_file():
        for line in path.read_text(encoding="utf-8").splitlines():
            data = json.loads(line)
            done[data["cell"], data["seed"]] = Outcome(**(data | {"causes": tuple(data["causes"])}))
    path.parent.mkdir(parents=True, exist_ok=True)
    todo = [one for one in wanted if one not in done]
    with path.open("a", encoding="utf-8") as lines:
        for count, (cell, seed) in enumerate(todo, 1):
            done[cell, seed] = run(cell, seed)
            lines.write(json.dumps(asdict(done[cell, seed])) + "\n")
            lines.flush()
            print(f"\r{count}/{len(todo)} {cell} ", end="", file=sys.stderr, flush=True)
    return {one: done[one] for one in wanted}


def row(name: str, runs: Sequence[Outcome], right: tuple[str, ...]) -> str:
    """The table's row of one cell."""
    good = [r for r in runs if not r.failure]
    loud, silent = [r for r in good if not r.trusted], [r for r in good if r.trusted]

    def percent(count: int, of: int) -> str:
        return f"{100.0 * count / of:.0f}" if of else "-"

    def mean(values: list[float]) -> str:
        known = [v for v in values if np.isfinite(v)]
        return f"{100.0 * float(np.mean(known)):.0f}" if known else "-"

    first = sum(bool(r.causes) and r.causes[0] in right for r in loud)
    named = sum(any(c in right for c in r.causes) for r in loud)
    causes = f"{percent(first, len(loud))} / {percent(named, len(loud))}" if right else "-"
    z = [r.z for r in silent if np.isfinite(r.z)]
    root = f"{float(np.sqrt(np.mean(np.square(z)))):.2f}" if z else "-"
    return (
        f"| {name} | {len(runs)} ({len(runs) - len(good)}) | {percent(len(loud), len(good))} ({len(loud)}) | {causes} "
        f"| {mean([r.inside for r in silent])} | {root} | {mean([r.inside for r in loud])} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=40, help="of each breakage")
    parser.add_argument("--clean", type=int, default=210, help="recordings as the model takes them to be, in all")
    parser.add_argument("--kept", type=Path, help="file that the runs are added to; default: one a version of the code")
    asked = parser.parse_args()
    each = -(-asked.clean // len(CLEAN))
    clean = [(f"clean: {errors}", i * each + j) for j in range(each) for i, errors in enumerate(CLEAN)]
    broken = [(cell, 1000 + seed) for seed in range(asked.runs) for cell in BROKEN]
    done = study([*clean, *broken], asked.kept or kept())
    print(
        "| recording | runs (failed) | alarms [%] (runs) | right cause first / named [%] | band holds k: silent [%] "
        "| RMS error / sd: silent | band holds k: alarmed [%] |"
    )
    print("| --- " * 7 + "|")
    for cell in dict.fromkeys(cell for cell, _ in [*clean, *broken]):
        runs = [one for (name, _), one in done.items() if name == cell]
        print(row(cell, runs, BROKEN[cell].names if cell in BROKEN else ()))
    print(row("all clean ones", [one for (name, _), one in done.items() if name not in BROKEN], ()))


if __name__ == "__main__":
    main()
