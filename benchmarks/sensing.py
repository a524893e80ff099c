"""The beam as a force sensor: how far the force is from the truth, and how often its regions hold it."""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from math import nan
from pathlib import Path
from typing import Any, Literal

import numpy as np

from onebend.errors import LearningError, MechanicsError, ObservationError, RecordingError
from onebend.lab.bench import PushProfile
from onebend.lab.designs import force_that_bends
from onebend.lab.random_bench import PLACES, BenchRanges, random_bench
from onebend.lab.virtual import VirtualBench, observe_virtual, virtual_recording
from onebend.learning.frames import at_frames
from onebend.learning.instruments import instruments_of, setup_of
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import fit
from onebend.learning.sensing.forces import TOUCH
from onebend.learning.sensing.sense import Sensed, SenseSettings, sense
from onebend.records import PLACE_SD, Array, BoolArray
from onebend.report.sentences import worded
from onebend.results.model import StoredModel, read_model, save_model
from tests.lab.from_truth import observe_from_truth

ROOT = Path(__file__).parents[1]
BENCHES = BenchRanges(fps=(15.0,))
WAYS = ("across", "any")
KINDS: dict[str, tuple[str, Literal["known", "unknown"], int]] = {  # direction, place, and how many of each beam
    "across the beam, place said": ("across", "known", 9),
    "any direction, place said": ("any", "known", 3),
    "across the beam, place sought": ("across", "unknown", 1),
}
NUMBERS = ("squared", "best", "best_sd", "least", "least_sd", "place", "place_sd")
LARGEST = 4.0  # of k/L, as the prior of a force expects it
FRAMES = 6  # of a push that are looked at
JUDGED = 3  # pushes of each beam whose force log is judged
AXES_SD, GAIN_SD = np.radians(3.0), 0.05  # of the logs that are judged
JUDGEMENTS = {"direction [deg]": 180.0 / np.pi, "gain [%]": 100.0, "delay [ms]": 1e3}
LEARNING = FitSettings(most_frames=120, first_frames=60)  # of pushes of some 8 s


@cache
def kept() -> Path:
    """The folder of what this very code made."""
    digest = hashlib.sha256()
    for source in sorted([*(ROOT / "src").rglob("*.py"), Path(__file__)]):
        digest.update(source.read_bytes())
    return ROOT / "out" / "benchmarks" / f"sensing-{digest.hexdigest()[:12]}"


def bench_of(beam: int) -> VirtualBench:
    """A random beam on a random bench, pushed slowly."""
    bench = random_bench(np.random.default_rng([beam, 22]), BENCHES, name=f"beam {beam}").bench
    return bench


def learned(beam: int) -> StoredModel | None:
    """Its model, from one push; kept in a file. None: this push teaches nothing."""
    file = kept() / f"model-{beam:03d}.json"
    if not file.exists():
        bench = bench_of(beam)
        try:
            seen = observe_virtual(virtual_recording(bench, seed=beam))
            found = fit([seen], settings=LEARNING, gain_sd=bench.declared.gain_sd)
        except (LearningError, MechanicsError, ObservationError, RecordingError) as wrong:
            print(beam, wrong)
            return None
        file.parent.mkdir(parents=True, exist_ok=True)
        save_model(
            file,
            found.beam,
            written_by="benchmarks",
            uncertain=found.stiffness,
            bench=instruments_of(found),
            setup=setup_of(found),
        )
    return read_model(file)


def pushed(beam: int, push: int, way: str) -> VirtualBench:
    """The same beam with the same tags, clamped anew and pushed otherwise: "across" the beam, or in "any" direction.

    Where the push acts is off by as much as is said; it turns the pushed place by 20 to 75 degrees.
    """
    bench = bench_of(beam)
    rng = np.random.default_rng([beam, push, WAYS.index(way), 23])
    side = float(rng.choice([-1.0, 1.0]))
    direction = side * float(rng.uniform(1.3, 1.9) if way == "across" else rng.uniform(0.0, np.pi))
    stated, place_sd = float(rng.choice([0.95, 0.8, 0.6])), float(rng.choice([5e-4, PLACE_SD]))
    at_s = stated + place_sd / bench.beam.length * float(np.clip(rng.standard_normal(), -2.2, 2.2))
    largest = LARGEST * float(np.mean(np.asarray(bench.beam.stiffness(PLACES)))) / bench.beam.length
    peak = min(force_that_bends(bench.beam, float(np.radians(rng.uniform(20.0, 75.0))), direction, at_s), largest)
    placement = bench.declared.placement_sd
    return replace(
        bench,
        push=PushProfile(peak, direction=direction, at_s=at_s),
        base=(*rng.normal(0.0, placement, 2).tolist(), float(rng.normal(0.0, np.radians(1.0)))),
        declared=replace(bench.declared, push_s=stated, place_sd=place_sd),
        name=f"beam {beam}, push {push}",
    )


def sensed(beam: int, push: int, way: str, settings: SenseSettings = SenseSettings()) -> tuple[Sensed, Array, float]:
    """What is told of one push, the true forces (F, 2) [N] and the largest of them."""
    model = learned(beam)
    assert model is not None
    bench = pushed(beam, push, way)
    virtual = virtual_recording(bench, seed=1000 * (beam + 1) + push)
    o = observe_from_truth(virtual)
    size = np.linalg.norm(virtual.force, axis=1)[o.frame]
    chosen = np.zeros(len(o.time), dtype=bool)
    rows = np.flatnonzero(size > 0.1 * size.max())
    chosen[rows[np.linspace(0, len(rows) - 1, FRAMES).astype(int)]] = True
    part = at_frames(o, chosen)
    found = sense(model.beam, part, stiffness=model.uncertain, setup=model.setup, settings=settings)
    return found, virtual.force[part.frame], float(size.max())


def row_of(beam: int, push: int, kind: str) -> dict[str, Any]:
    """One run, for a line of JSON: frames (F) of what was told against the truth, in parts of the largest force."""
    way, place = KINDS[kind][:2]
    began = time.perf_counter()
    out: dict[str, Any] = {"beam": beam, "push": push, "kind": kind}
    try:
        found, true, peak = sensed(beam, push, way, SenseSettings(place=place))
    except (LearningError, MechanicsError, RecordingError, np.linalg.LinAlgError) as wrong:
        return out | {"failure": f"{type(wrong).__name__}: {wrong}"}
    away, angle = found.force - true, found.weak_angle
    least = away[:, 0] * np.cos(angle) + away[:, 1] * np.sin(angle)
    best = away[:, 1] * np.cos(angle) - away[:, 0] * np.sin(angle)
    squared = np.einsum("tc,tcd,td->t", away, np.linalg.inv(found.covariance), away)
    off = np.abs(found.place - pushed(beam, push, way).push.at_s)
    columns = {
        "squared": squared,
        "best": best / peak,
        "best_sd": found.strong_sd / peak,
        "least": least / peak,
        "least_sd": found.weak_sd / peak,
        "place": off,
        "place_sd": found.place_sd,
    }
    out |= {name: [float(f"{x:.5g}") for x in values] for name, values in columns.items()}
    fit = found.misfit
    return out | {"warned": warned(found), "ratio": fit.ratio if fit else nan, "seconds": time.perf_counter() - began}


def warned(found: Sensed) -> bool:
    """Whether it says that the model does not explain the shapes."""
    return any(one.level == "warning" for one in worded(found.remarks))


def judged(beam: int, push: int) -> dict[str, Any]:
    """A log whose axes, gain and lag are wrong, judged by the beam: what is said of each, its sd, and the truth."""
    out: dict[str, Any] = {"beam": beam, "push": push, "kind": "judged"}
    rng = np.random.default_rng([beam, push, 24])
    bench, model = pushed(beam, push, "across"), learned(beam)
    assert model is not None
    turned, gain = float(rng.normal(0.0, AXES_SD)), 1.0 + float(rng.normal(0.0, GAIN_SD))
    sensor = replace(bench.sensor, gain=gain, gain_sd=0.0)
    bench = replace(bench, sensor=sensor, declared=replace(bench.declared, axes=turned))
    try:
        o = observe_virtual(virtual_recording(bench, seed=1000 * (beam + 1) + push))
        found = sense(model.beam, o, stiffness=model.uncertain, setup=model.setup)
    except (LearningError, MechanicsError, ObservationError, RecordingError, np.linalg.LinAlgError) as wrong:
        return out | {"failure": f"{type(wrong).__name__}: {wrong}"}
    if found.sensor is None or o.source.clock is None:
        return out | {"failure": "not judged"}
    late = sensor.lag + bench.clock.offset - o.source.clock.offset
    said = (found.sensor.direction, found.sensor.gain, found.sensor.delay)
    truth = dict(zip(JUDGEMENTS, (turned, gain, late), strict=True))
    return out | {name: [*one, truth[name]] for name, one in zip(JUDGEMENTS, said, strict=True)}


def judged_table(rows: list[dict[str, Any]]) -> str:
    """What the beam says of the logs."""
    good = [one for one in rows if "failure" not in one]
    beams = np.array([one["beam"] for one in good])
    lines = ["| of a log | logs (not judged) | error, RMS | sd, RMS / median | error over sd | inside 95 % [%] |"]
    lines.append("| --- " * 6 + "|")
    for name, unit in JUDGEMENTS.items():
        value, sd, truth = np.array([one[name] for one in good]).T
        over = (value - truth) / sd
        sizes = f"{unit * rms(value - truth):.2g} | {unit * rms(sd):.2g} / {unit * np.median(sd):.2g}"
        inside = by_beam(np.abs(over) < 1.96, beams)
        lines.append(f"| {name} | {len(good)} ({len(rows) - len(good)}) | {sizes} | {rms(over):.2f} | {inside} |")
    return "\n".join(lines)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def study(beams: int, part: float, kinds: Sequence[str]) -> list[dict[str, Any]]:
    """Every run of these beams; what was done before is in a file, and is not done again."""
    file = kept() / "runs.jsonl"
    file.parent.mkdir(parents=True, exist_ok=True)
    done = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []
    known = {(one["kind"], one["beam"], one["push"]) for one in done}
    good = [beam for beam in range(beams) if is_learned(beam)]
    counts = {kind: n for kind, (*_, n) in KINDS.items()} | {"judged": JUDGED}
    wanted = [(k, b, p) for k in kinds for p in range(max(int(counts[k] * part), 1)) for b in good]
    with file.open("a", encoding="utf-8") as lines:
        for kind, beam, push in wanted:
            if (kind, beam, push) not in known:
                done.append(judged(beam, push) if kind == "judged" else row_of(beam, push, kind))
                lines.write(json.dumps(done[-1]) + "\n")
                lines.flush()
    chosen = set(wanted)
    return [one for one in done if (one["kind"], one["beam"], one["push"]) in chosen]


def is_learned(beam: int) -> bool:
    """Whether its push taught a model that the fit does not doubt."""
    model = learned(beam)
    return model is not None and model.uncertain is not None and not model.uncertain.doubts


def by_beam(hits: BoolArray, beams: Array) -> str:
    """A share [%] and its standard error, the runs of a beam not being independent."""
    value = float(np.mean(hits))
    sums = np.array([np.sum(hits[beams == b] - value) for b in np.unique(beams)])
    return f"{100.0 * value:.1f} ± {100.0 * np.sqrt(np.sum(sums**2)) / len(hits):.1f}"


def table_row(kind: str, rows: list[dict[str, Any]]) -> str:
    """A row of the page."""
    good = [one for one in rows if "squared" in one]
    beams = np.repeat([one["beam"] for one in good], [len(one["squared"]) for one in good])
    column = {name: np.concatenate([np.asarray(one[name], dtype=float) for one in good]) for name in NUMBERS}
    inside = column["squared"] < TOUCH
    best, least = (np.abs(column[name]) < 1.96 * column[f"{name}_sd"] for name in ("best", "least"))
    sizes = " / ".join(f"{100.0 * np.median(np.abs(column[n])):.2g}" for n in ("best", "least"))
    sds = " / ".join(f"{100.0 * np.median(column[f'{n}_sd']):.2g}" for n in ("best", "least"))
    told = np.isfinite(column["place"])
    place = f"{np.sqrt(np.mean(column['place'][told] ** 2)):.3f} ({100.0 * np.mean(told):.0f} %)"
    shares = " | ".join(by_beam(hits, beams) for hits in (inside, best, least))
    noticed = 100.0 * np.mean([one["warned"] for one in good])
    return f"| {kind} | {len(good)} ({len(rows) - len(good)}) | {shares} | {sizes} | {sds} | {place} | {noticed:.1f} |"


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table."""
    lines = [
        "| pushes | runs (failed) | truth inside the 95 % region [%] | where known best [%] | where known least [%] "
        "| median error, best / least [% of the peak] | median sd [%] | place off, RMS [L] (told) | warned [%] |",
        "| --- " * 9 + "|",
    ]
    return "\n".join(lines + [table_row(kind, [one for one in rows if one["kind"] == kind]) for kind in KINDS])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--beams", type=int, default=120, help="random beams, each learned from one push")
    parser.add_argument("--part", type=float, default=1.0, help="of the pushes of each")
    parser.add_argument("--judged", action="store_true", help="judge force logs alone")
    asked = parser.parse_args()
    if not asked.judged:
        print(markdown(study(asked.beams, asked.part, list(KINDS))), end="\n\n")
    print(judged_table(study(asked.beams, asked.part, ["judged"])))


if __name__ == "__main__":
    main()
