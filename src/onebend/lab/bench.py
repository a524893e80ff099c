"""Effects of a real bench; pushes; errors of force sensors and of tag detection."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, sqrt

import numpy as np
from scipy.signal import lfilter

from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers
from onebend.errors import RecordingError
from onebend.records import Array, ForceLog, IntArray, unit

SHEAR_FACTOR = 5.0 / 6.0  # of a rectangle
PATCH_OVER_TAG = 1.25  # patch length over the side of the tag's black square


@dataclass(frozen=True)
class RealBench:
    """Departures of a real bench from the ideal one."""

    # The beam
    thickness: float = 0.0  # m, mean, in the plane of bending; h(s) ~ k^(1/3). 0: no stretch or shear
    poisson: float = 0.45
    relaxation: float = 0.0  # share of the stiffness (standard linear solid)
    relaxation_time: float = 3.0  # s
    patch_factor: float = 1.0  # of k under each tag
    patch_length: float = PATCH_OVER_TAG * 0.012  # m, centred on the tag
    rest_turn: tuple[float, ...] = ()  # rad, coefficients of s^0, s^1, ...; added to the beam's rest curvature
    inertia: bool = False  # quasi-static: the beam follows the push without swinging
    # How it is held and pushed
    clamp_compliance: float = 0.0  # rad/(N m)
    slide: float = 0.0  # m the contact moves outwards per rad of rotation there
    push_off: float = 0.0  # m the first contact lies further out than stated
    length_off: float = 0.0  # relative excess of the stated length
    # The sensor
    posture_bias: float = 0.0  # largest error as a share of the peak; depends on the tool's place
    # coefficients of x, y, x^2, xy, y^2; two components
    posture_shape: tuple[float, ...] = (1.0, 0.5, -0.8, 0.3, 0.6, -0.4, 0.9, 0.5, -0.7, 0.2)
    # The picture (films only)
    base_height: float = 0.0  # m, base tag towards the camera, from the plane of the other tags
    tag_heights: tuple[float, ...] = ()  # m, one per tag on the beam, or none
    tag_tilts: tuple[tuple[float, float], ...] = ()  # rad, about the beam's direction and across it
    droop: float = 0.0  # m the straight beam's tip hangs out of the plane, away from the camera
    shake: float = 0.0  # px RMS per axis
    shake_band: tuple[float, float] = (3.0, 8.0)  # Hz
    drift: float = 0.0  # px, from first to last frame
    readout: float = 0.0  # s, first to last row (rolling shutter)

    def __post_init__(self) -> None:
        sizes = (self.thickness, self.clamp_compliance, self.posture_bias, self.shake, self.drift, self.readout)
        if not all(np.isfinite(v) and v >= 0.0 for v in sizes):
            raise RecordingError(
                "thickness, clamp compliance, posture bias, shake, drift and read-out time are finite and not negative"
            )
        if not (0.0 <= self.relaxation < 1.0 and self.relaxation_time > 0.0):
            raise RecordingError("relaxation is a share in [0, 1), its time is above zero")
        if not (self.patch_factor > 0.0 and self.patch_length > 0.0):
            raise RecordingError("a patch needs a factor and a length above zero")
        if not (self.length_off > -1.0 and -1.0 < self.poisson <= 0.5):
            raise RecordingError("a length is off by more than -1, and Poisson's ratio is in (-1, 0.5]")
        if len(self.posture_shape) != 10 or not 0.0 < self.shake_band[0] < self.shake_band[1]:
            raise RecordingError("a posture's shape has 10 coefficients, and a shake a band of rising frequencies")

    @property
    def moves_otherwise(self) -> bool:
        """Whether any effect changes the motion of the beam or the place of the push."""
        sizes = (self.thickness, self.relaxation, self.clamp_compliance, self.slide, self.push_off)
        return any(sizes) or any(self.rest_turn) or self.patch_factor != 1.0 or self.inertia


def patch_ends(effects: RealBench, length: float, tags: Array) -> Array:
    """(m, 2) s, ends of the stiff patch under each tag (m,), not clipped at the tip; (0, 2) without patches."""
    if effects.patch_factor == 1.0:
        return np.zeros((0, 2))
    half = 0.5 * effects.patch_length / length
    return np.stack([tags - half, tags + half], axis=1)


def instant_stiffness(beam: Beam, effects: RealBench, tags: Array, s: Array) -> Array:
    """k(s) [N m] before relaxation, with the patches under `tags` (m,)."""
    patches = patch_ends(effects, beam.length, tags)
    under = np.any((s[:, None] > patches[:, 0]) & (s[:, None] < patches[:, 1]), axis=1)
    return np.asarray(beam.stiffness(s)) * np.where(under, effects.patch_factor, 1.0)


def section_flexibility(beam: Beam, effects: RealBench, s: Array) -> tuple[Array, Array]:
    """1/EA and 1/kGA [1/N] at `s` (S,): EA = 12 EI / h^2, kGA = 5/6 EA / (2 (1 + nu)); zeros without thickness."""
    if effects.thickness == 0.0:
        return np.zeros(len(s)), np.zeros(len(s))
    k = np.asarray(beam.stiffness(s))
    mean = float(np.mean(np.asarray(beam.stiffness(np.linspace(0.0, 1.0, 401)))))
    thickness = effects.thickness * np.cbrt(k / mean)
    per_stretch = thickness**2 / (12.0 * k * beam.length)
    return per_stretch, per_stretch * 2.0 * (1.0 + effects.poisson) / SHEAR_FACTOR


def rest_curvature(beam: Beam, effects: RealBench, s: Array) -> Array:
    """(S,) rad, of beam and bench."""
    own = np.asarray(beam.rest_curvature(s))
    return own + np.asarray(Powers(effects.rest_turn)(s)) if effects.rest_turn else own


def posture_bias(effects: RealBench, tool: Array, length: float, peak: float) -> Array:
    """(T, 2) N at the tool's places (T, 2) [m], the first at rest: a quadratic polynomial, zero at rest.

    Its largest size over these places is the `posture_bias` share of the peak [N].
    """
    x, y = ((tool - tool[0]) / length).T
    terms = np.stack([x, y, x**2, x * y, y**2], axis=-1)
    error = terms @ np.asarray(effects.posture_shape).reshape(2, 5).T
    largest = float(np.max(np.linalg.norm(error, axis=1)))
    return np.asarray(error * (effects.posture_bias * peak / largest if largest > 0.0 else 0.0))


@dataclass(frozen=True)
class PushProfile:
    """The force of a tool: rest, rise, hold, fall, rest. The film begins at 0 s."""

    peak: float  # N
    direction: float = 1.75  # rad from the beam's x axis, at mid-push
    turn: float = 0.5  # rad the direction turns from first to last contact
    at_s: float = 1.0
    before: float = 1.5  # s, rest
    rise: float = 2.0  # s
    hold: float = 0.3  # s
    fall: float = 2.0  # s
    after: float = 1.0  # s, rest; 0: the push is held to the end

    def __post_init__(self) -> None:
        if not (self.rise > 0.0 and self.fall > 0.0 and min(self.before, self.hold, self.after) >= 0.0):
            raise RecordingError("a push needs a rise and a fall that last, and no negative times")
        if not 0.0 < self.at_s <= 1.0:
            raise RecordingError(f"a push acts at s in (0, 1], got {self.at_s}")

    @property
    def contact(self) -> tuple[float, float]:
        """s, first and last contact."""
        return self.before, self.before + self.rise + self.hold + self.fall

    @property
    def duration(self) -> float:
        return self.contact[1] + self.after

    def force(self, time: Array) -> Array:
        begin, end = self.contact
        part = smooth((time - begin) / self.rise) - smooth((time - end + self.fall) / self.fall)
        angle = self.angle(time)
        return np.asarray(self.peak * part[:, None] * unit(angle))

    def angle(self, time: Array) -> Array:
        """(N,) rad, the direction at `time` (N,) [s]; defined before and after contact too."""
        begin, end = self.contact
        return np.asarray(self.direction + self.turn * (np.clip((time - begin) / (end - begin), 0.0, 1.0) - 0.5))


def smooth(part: Array) -> Array:
    """0 to 1 with continuous velocity and acceleration."""
    u = np.clip(part, 0.0, 1.0)
    return np.asarray(u**3 * (10.0 - 15.0 * u + 6.0 * u**2))


TURN = 0.05  # of the largest load: a smaller drop is no reversal
FORGET = 0.05  # s: time constant from one load direction's error to the next


@dataclass(frozen=True)
class ForceSensor:
    """`log = gain F(t - lag) + bias + walk + reversal + coloured + white`, then rounded, with rows dropped.

    `gain_sd`: sd of one log's gain about `gain`.
    """

    rate: float = 200.0  # Hz
    white_sd: float = 0.0  # N per sample
    coloured_sd: float = 0.0  # N, sd of an Ornstein-Uhlenbeck process
    coloured_time: float = 0.3  # s
    bias: tuple[float, float] = (0.0, 0.0)
    drift: float = 0.0  # N per root second (random walk)
    reversal: float = 0.0  # N, sd of an error redrawn at every start and reversal of the load
    gain: float = 1.0
    gain_sd: float = 0.0
    lag: float = 0.0  # s
    drops: float = 0.0  # share of rows lost
    quantum: float = 0.0  # N, rounding step; 0: none

    def __post_init__(self) -> None:
        sizes = (self.white_sd, self.coloured_sd, self.drift, self.reversal, self.gain_sd, self.quantum)
        if not all(isfinite(v) and v >= 0.0 for v in (*sizes, self.lag)):
            raise RecordingError("a sensor's noise sizes and its lag must be finite and not negative")
        if not (self.rate > 0.0 and self.coloured_time > 0.0 and 0.0 <= self.drops < 1.0):
            raise RecordingError("a sensor needs a rate and a correlation time above zero, and drops in [0, 1)")


# A Franka's own force estimate, from public logs of that robot. White noise and lost rows: rayangdn/virtual_tactile_pad
# (12 logs beside an ATI Gamma at 3 to 7 N; the error after the tare is 0.22 N RMS along x and lasts until the load
# reverses). Scatter within a second: sebtiburzio/dlo_parameter_id. Steady bias: frankarobotics/franka_ros issue 404.
# Gain 0.93 to 1.43 (sd 0.13), lag 25 to 50 ms.
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
# A small six-axis wrist sensor (range 10 to 30 N), after typical data sheets: resolution and noise of a few mN, 1 % of
# scale, bias from the tool's weight, thermal drift.
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
    """The log for the force (N, 2) [N] at `time` (N,) [s]; its clock is `offset` [s] ahead.

    The force is interpolated linearly: give it at least at the sensor's rate. Raises `RecordingError`: times that do
    not rise, or mismatched shapes.
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
    """(N, 2) N that the sensor adds to a force (N, 2) sampled evenly."""
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
    """(N,) stage of the load: 0 before it, then counting every start of growth or fall."""
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


@dataclass(frozen=True)
class TagNoise:
    """White and time-correlated noise of tag poses; the stated covariance may be wrong."""

    white_xy: float = 2e-5  # m
    white_angle: float = 1e-3  # rad
    slow_xy: float = 0.0  # m, Ornstein-Uhlenbeck
    slow_angle: float = 0.0  # rad
    slow_time: float = 0.5  # s
    stated: float = 1.0  # stated sd over the true sd of one frame
    outliers: float = 0.0  # share of poses with an extra error of `outlier_xy`, `outlier_angle` (sd)
    outlier_xy: float = 2e-3  # m
    outlier_angle: float = 0.05  # rad
    missing: float = 0.0  # share of poses not seen


def filmed(noise: TagNoise, pose: Array, step: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Observed poses (T, m, 3) [m, m, rad] every `step` [s], NaN where missing, and their covariance (T, m, 3, 3)."""
    count, tags = pose.shape[:2]
    white = np.array([noise.white_xy, noise.white_xy, noise.white_angle])
    slow = np.array([noise.slow_xy, noise.slow_xy, noise.slow_angle])
    far = np.array([noise.outlier_xy, noise.outlier_xy, noise.outlier_angle])
    measured = pose + white * rng.standard_normal(pose.shape)
    pairs = [coloured(count, step, noise.slow_time, rng) for _ in range((3 * tags + 1) // 2)]
    measured = measured + slow * np.concatenate(pairs, axis=1)[:, : 3 * tags].reshape(count, tags, 3)
    wrong = rng.random((count, tags)) < noise.outliers
    measured = measured + wrong[..., None] * far * rng.standard_normal(pose.shape)
    measured[rng.random((count, tags)) < noise.missing] = np.nan
    sd = noise.stated * np.sqrt(white**2 + slow**2)
    return measured, np.tile(np.diag(sd**2), (count, tags, 1, 1))
