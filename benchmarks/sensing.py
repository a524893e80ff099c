"""The beam as a force sensor: how far the force is from the truth, and how often its regions hold it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from onebend.errors import LearningError, MechanicsError, ObservationError, RecordingError
from onebend.lab.direct_observation import observe_from_truth
from onebend.lab.random_bench import BenchRanges, random_bench
from onebend.lab.virtual import VirtualBench, observe_virtual, virtual_recording
from onebend.learning.design.instruments import instruments_of
from onebend.learning.inference.stages import FitSettings
from onebend.learning.posterior import fit
from onebend.results.model import StoredModel, read_model, save_model

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "out" / "benchmarks" / "sensing"
BENCHES = BenchRanges(fps=(15.0,))
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
