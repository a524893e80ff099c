"""The clock of a long film that shows several pushes: its error against the sd that is claimed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from onebend.lab.bench import ForceSensor, PushProfile
from onebend.lab.designs import force_that_bends
from onebend.lab.virtual import VirtualBench, virtual_recording
from onebend.recording.force import match_clocks
from onebend.recording.tracks import with_angles
from onebend.records import Array
from tests.made_up import BEAM

PEAK = force_that_bends(BEAM, 1.0, 1.75)
SHARES = (1.0, 0.5, 0.8, 0.6, 0.9, 0.7, 0.55, 0.95)  # of the largest peak, push by push
PAUSE = 1.5  # s
EXACT = 2e-3  # s: errors below it do no harm


@dataclass(frozen=True)
class SeveralPushes(PushProfile):
    """Pushes of different peaks, one after the other."""

    @property
    def every(self) -> float:
        """s from the beginning of one push to that of the next."""
        return self.rise + self.hold + self.fall + PAUSE

    @property
    def contact(self) -> tuple[float, float]:
        return self.before, self.before + len(SHARES) * self.every - PAUSE

    def force(self, time: Array) -> Array:
        one = PushProfile(self.peak, before=self.before)
        parts = [share * one.force(time - i * self.every) for i, share in enumerate(SHARES)]
        return np.asarray(np.sum(parts, axis=0))

    def angle(self, time: Array) -> Array:
        return np.full(len(time), self.direction)


@pytest.mark.slow
@pytest.mark.parametrize("coloured", [0.0, 0.03])
def test_a_film_of_eight_pushes_claims_no_better_clock_than_it_has(coloured: float) -> None:
    sensor = ForceSensor(white_sd=0.02 * PEAK, coloured_sd=coloured * PEAK)
    bench = VirtualBench(beam=BEAM, push=SeveralPushes(PEAK), sensor=sensor, fps=30.0)
    said = replace(bench.clock, declared=bench.clock.offset + 1.1, uncertainty=2.0)
    made = virtual_recording(replace(bench, clock=said), seed=3)
    assert len(made.markers.time) > 1000
    markers = with_angles(made.markers)
    clock = match_clocks(made.recording, markers, made.log, None)[1].clock
    assert clock.found
    assert abs(clock.offset - bench.clock.offset - sensor.lag) < 3.0 * np.hypot(clock.sd, EXACT)
