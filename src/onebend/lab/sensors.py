"""Force sensors with their errors: the log that a known force gives."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, sqrt

import numpy as np
from scipy.signal import lfilter

from onebend.errors import RecordingError
from onebend.records import Array, ForceLog, IntArray

TURN = 0.05  # of the largest load: a load that comes back by less has not reversed
FORGET = 0.05  # s: time constant with which the error of one direction of load gives way to the next one's


@dataclass(frozen=True)
class ForceSensor:
    """`log = gain F(t - lag) + bias + walk + reversal + coloured + white`, then rounded; some rows are lost.

    `gain_sd`: the gain of one log is drawn around `gain` with this sd.
    """

    rate: float = 200.0  # Hz
    white_sd: float = 0.0  # N, of one sample
    coloured_sd: float = 0.0  # N, Ornstein-Uhlenbeck: sd, exponential correlation
    coloured_time: float = 0.3  # s
    bias: tuple[float, float] = (0.0, 0.0)  # N, steady
    drift: float = 0.0  # N per root second: random walk
    reversal: float = 0.0  # N, sd of an error that is drawn anew whenever the load begins, grows again or falls again
    gain: float = 1.0
    gain_sd: float = 0.0
    lag: float = 0.0  # s
    drops: float = 0.0  # share of rows that are missing
    quantum: float = 0.0  # N, step of the numbers; 0: none

    def __post_init__(self) -> None:
        sizes = (self.white_sd, self.coloured_sd, self.drift, self.reversal, self.gain_sd, self.quantum)
        if not all(isfinite(v) and v >= 0.0 for v in (*sizes, self.lag)):
            raise RecordingError("a sensor's noise sizes and its lag must be finite and not negative")
        if not (self.rate > 0.0 and self.coloured_time > 0.0 and 0.0 <= self.drops < 1.0):
            raise RecordingError("a sensor needs a rate and a correlation time above zero, and drops in [0, 1)")


# A Franka's own estimate of the external force. Figures from public logs of that robot: white noise and drops from
# rayangdn/virtual_tactile_pad (12 logs beside an ATI Gamma at loads of 3 to 7 N; the error after the tare is 0.22 N RMS
# along x and stays until the load reverses), scatter within a second from sebtiburzio/dlo_parameter_id, the steady bias
# from frankarobotics/franka_ros issue 404; gain 0.93 to 1.43 (sd 0.13), lag 25 to 50 ms.
FRANKA = ForceSensor(
    rate=80.0,
    white_sd=0.014,
    coloured_sd=0.02,
    coloured_time=0.3,
    bias=(1.4, -0.37),
    reversal=0.22,
    gain_sd=0.13,
    lag=0.035,
    drops=0.004,
)
# A small six-axis sensor at a wrist (10 to 30 N range). Typical figures of data sheets: resolution a few mN, noise
# about as much, 1 % of scale; bias from the tool's weight; drift with temperature.
WRIST = ForceSensor(
    rate=500.0,
    white_sd=0.005,
    coloured_sd=0.002,
    coloured_time=1.0,
    bias=(0.4, -0.2),
    drift=0.001,
    gain_sd=0.01,
    lag=0.002,
    quantum=0.003,
)


def log_of(
    sensor: ForceSensor, time: Array, force: Array, rng: np.random.Generator, *, offset: float = 0.0
) -> ForceLog:
    """What `sensor` logs of the force (N, 2) [N] at `time` (N,) [s], on a clock that is `offset` [s] ahead.

    The force runs straight between its samples, so that these should be at least as dense as the sensor's.

    Raises:
        RecordingError: times that do not rise, or shapes that do not fit.
    """
    if force.shape != (len(time), 2) or len(time) < 2 or not np.all(np.diff(time) > 0.0):
        raise RecordingError(f"a log needs a force (N, 2) at rising times (N,), got {force.shape} at {time.shape}")
    at = np.arange(time[0], time[-1] + 1e-9, 1.0 / sensor.rate)
    now = np.stack([np.interp(at - sensor.lag, time, column) for column in force.T], axis=1)
    gain = sensor.gain + sensor.gain_sd * rng.standard_normal()
    shown = gain * now + force_error(sensor, at, now, rng)
    if sensor.quantum > 0.0:
        shown = sensor.quantum * np.round(shown / sensor.quantum)
    kept = rng.random(len(at)) >= sensor.drops
    return ForceLog(at[kept] + offset, shown[kept])


def force_error(sensor: ForceSensor, time: Array, force: Array, rng: np.random.Generator) -> Array:
    """(N, 2) N that the sensor adds to a force (N, 2) at even times (N,)."""
    step = 1.0 / sensor.rate
    shape = (len(time), 2)
    white = sensor.white_sd * rng.standard_normal(shape)
    slow = coloured(len(time), step, sensor.coloured_time, rng) * sensor.coloured_sd
    walk = np.cumsum(rng.standard_normal(shape), axis=0) * sensor.drift * sqrt(step)
    stage = stages(force)
    levels = sensor.reversal * rng.standard_normal((int(stage.max()) + 1, 2))
    keep = np.exp(-step / FORGET)
    jumps = lfilter([1.0 - keep], [1.0, -keep], levels[stage] - levels[0], axis=0) + levels[0]
    return np.asarray(np.asarray(sensor.bias) + white + slow + walk + jumps)


def coloured(count: int, step: float, time_constant: float, rng: np.random.Generator) -> Array:
    """(count, 2) of an Ornstein-Uhlenbeck process of sd 1, exact at even steps [s]."""
    keep = np.exp(-step / time_constant)
    kicks = np.sqrt(1.0 - keep**2) * rng.standard_normal((count, 2))
    kicks[0] = rng.standard_normal(2)
    return np.asarray(lfilter([1.0], [1.0, -keep], kicks, axis=0))


def stages(force: Array) -> IntArray:
    """(N,) number of the stage of the load: 0 before it, and one more each time it begins to grow or to fall."""
    size = np.linalg.norm(force, axis=1)
    margin = TURN * float(size.max(initial=0.0))
    out = np.zeros(len(size), dtype=np.int64)
    if margin == 0.0:
        return out
    stage, rising, extreme = 0, False, size[0]
    for i, now in enumerate(size):
        extreme = max(extreme, now) if rising else min(extreme, now)
        if (extreme - now if rising else now - extreme) > margin:
            stage, rising, extreme = stage + 1, not rising, now
        out[i] = stage
    return out
