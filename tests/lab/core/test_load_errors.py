"""A log whose error is as large as half of its force, and changes where the load begins and reverses: robots' logs."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.mistaken_place import drawn
from onebend.lab.virtual import virtual_recording
from onebend.recording.clock import fit_clock
from onebend.recording.clock_evidence import OffsetScan, averaged_over, peaks
from onebend.records import ForceNoise

GRID = np.linspace(-1.0, 1.0, 41)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1060, 1008, 1123, 1135])
def test_the_force_that_such_an_error_looks_like_does_not_mislead_the_clock(seed: int) -> None:
    """A search that takes the jump of the error at the first touch for force ends 0.5 to 1.3 s off, six of its sds."""
    bench = drawn(seed, mistaken=False)
    assert bench.sensor.reversal > 0.25 * bench.push.peak
    made, clock = virtual_recording(bench, seed=seed), bench.clock
    found = fit_clock(made.markers, made.log, clock.declared, clock.uncertainty, push_s=bench.push.at_s).clock
    assert found.found
    assert abs(found.offset - clock.offset - bench.sensor.lag) < min(0.2, 3.0 * found.sd)


def scan(*peaked: tuple[float, float]) -> OffsetScan:
    """Sharp maxima: offset [s] and height."""
    density = np.full(len(GRID), -1e4)
    for offset, height in peaked:
        density = np.maximum(density, height - 1e3 * (GRID - offset) ** 2)
    return OffsetScan(None, density, lambda: ForceNoise(1.0, 1.0, 1.0, 1.0))  # type: ignore[arg-type]


def test_peaks_that_may_be_right_are_looked_at_the_highest_of_each_search_first() -> None:
    low, high = scan((0.5, -100.0), (-0.5, -102.0)), scan((0.0, 10.0), (0.8, 1.0))
    assert np.allclose(peaks([low, high], GRID), [0.5, 0.0, -0.5])
    assert np.allclose(peaks([low, scan((0.45, 0.0), (0.0, -1.0))], GRID), [0.5, 0.0, -0.5])


def test_sets_of_features_count_by_their_evidence() -> None:
    ends = [(-0.4, 0.03), (0.2, 0.04)]
    mean, sd = averaged_over([scan((-0.4, 3.0)), scan((0.2, 3.0))], ends)
    assert mean == pytest.approx(-0.1)
    assert sd == pytest.approx(np.sqrt(0.3**2 + 0.5 * (0.03**2 + 0.04**2)))
    assert averaged_over([scan((-0.4, 23.0)), scan((0.2, 3.0))], ends) == pytest.approx((-0.4, 0.03), abs=1e-6)
    unknown = [(-0.4, np.inf), (0.2, 0.04)]
    assert averaged_over([scan((-0.4, 90.0)), scan((0.2, 3.0))], unknown) == pytest.approx((0.2, 0.04))
    assert averaged_over([scan((-0.4, 90.0)), scan((0.2, 3.0))], [(-0.4, np.inf), (0.2, np.inf)]) == (-0.4, np.inf)
