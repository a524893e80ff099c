"""The beam as a force sensor: how far the force is from the truth, and how often its regions hold it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from onebend.errors import LearningError, MechanicsError, ObservationError, RecordingError
from onebend.lab.direct_observation import observe_from_truth
from onebend.lab.pushes import PushProfile
from onebend.lab.random_beams import force_that_bends
from onebend.lab.random_bench import PLACES, BenchRanges, random_bench
from onebend.lab.virtual import VirtualBench, observe_virtual, virtual_recording
from onebend.learning.design.instruments import instruments_of
from onebend.learning.inference.stages import FitSettings
from onebend.learning.model.frames import at_frames
from onebend.learning.posterior import fit
from onebend.learning.sensing.sense import sense
from onebend.learning.sensing.sensed import Sensed, SenseSettings
from onebend.records import PLACE_SD, Array
from onebend.results.model import StoredModel, read_model, save_model

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "out" / "benchmarks" / "sensing"
BENCHES = BenchRanges(fps=(15.0,))
WAYS = ("across", "any")
LARGEST = 4.0  # of k/L, as the prior of a force expects it
FRAMES = 6  # of a push that are looked at
LEARNING = FitSettings(most_frames=120, first_frames=60)  # of pushes of some 8 s


def bench_of(beam: int) -> VirtualBench:
    """A random beam on a random bench, pushed slowly."""
    bench = random_bench(np.random.default_rng([beam, 22]), BENCHES, name=f"beam {beam}").bench
    return bench


def learned(beam: int) -> StoredModel | None:
    """Its model, from one push; kept in a file. None: this push teaches nothing."""
    file = KEPT / f"model-{beam:03d}.json"
    if not file.exists():
        bench = bench_of(beam)
        try:
            seen = observe_virtual(virtual_recording(bench, seed=beam))
            found = fit([seen], settings=LEARNING, gain_sd=bench.declared.gain_sd)
        except (LearningError, MechanicsError, ObservationError, RecordingError) as wrong:
            print(beam, wrong)
            return None
        file.parent.mkdir(parents=True, exist_ok=True)
        save_model(file, found.beam, written_by="benchmarks", uncertain=found.stiffness, bench=instruments_of(found))
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
    found = sense(model.beam, part, stiffness=model.uncertain, instruments=model.bench, settings=settings)
    return found, virtual.force[part.frame], float(size.max())
