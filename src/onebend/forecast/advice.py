"""What to change before filming: each change gives another setup; they are ranked by how much they narrow the band."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from onebend.blas import one_blas_thread
from onebend.errors import MechanicsError, RecordingError
from onebend.forecast.instruments import even_push, instruments
from onebend.forecast.prediction import PredictedBand, derivatives, information_of, with_information
from onebend.forecast.setup import Setup
from onebend.lab.pushes import PushProfile
from onebend.lab.sensors import WRIST, ForceSensor
from onebend.learning.design.candidates import Limits, largest_pushes
from onebend.learning.design.identifiability import solve_push
from onebend.learning.design.proposals import Quality, direction_words
from onebend.progress import Progress, Silent, track

AT_S = (0.5, 0.65, 0.8, 1.0)
DIRECTIONS_DEG = (70.0, 100.0, 130.0)
SIZES = (1.0, 0.6)  # of the largest force within the limits
LIMITS = Limits()  # the tip turns by no more than 90 deg, and nothing bends by more than 1.25 times what is planned
BETTER = 5.0  # times: a placement or a sensor that much better
GAIN_SD = 0.01  # after a calibration with a weight
SYNCHRONISED = 0.005  # s
GAP = 0.1  # in s: wider ones get a tag in the middle
APART = 0.15  # in s: nearer pushes are the same advice
LEAST_SHARE = 0.01  # of the band: what removes less is not worth saying
_SENSOR_SIZES = ("white_sd", "coloured_sd", "drift", "reversal", "gain_sd", "quantum")


@dataclass(frozen=True)
class SetupChange:
    """One change of the setup, and the band it would leave."""

    kind: str  # tag, push, second push, gain, sensor, placement, clock, camera
    text: str
    setup: Setup
    quality: Quality
    share: float  # of the mean width of the band that it removes; negative: it adds

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        pushes = [{"at_s": p.at_s, "direction_rad": p.direction, "peak_N": p.peak} for p in self.setup.pushes]
        done = {"tags_s": list(self.setup.tags), "pushes": pushes}
        return {"kind": self.kind, "text": self.text, "removes": self.share, "after": vars(self.quality), **done}


@one_blas_thread
def advise(
    setup: Setup, now: PredictedBand, *, count: int = 8, progress: Progress = Silent()
) -> tuple[SetupChange, ...]:
    """The changes that narrow the band most, best first; at most two of each kind.

    Raises:
        MechanicsError: the setup's own push has no stable equilibrium.
    """
    if count < 1:
        return ()
    thoughts = [*_tags(setup), *_pushes(setup), *_instruments(setup)]
    changes = []
    for kind, text, changed in track(progress, "weighing changes", thoughts, len(thoughts)):
        try:
            used = instruments(changed)
            information = information_of(changed, used, derivatives(changed, used))
        except MechanicsError:
            continue  # stable at the sampled sizes, but not on the way there
        quality = with_information(now, used, information).quality
        changes.append(SetupChange(kind, text, changed, quality, 1.0 - quality.mean_width / now.quality.mean_width))
    return _distinct(sorted(changes, key=lambda change: -change.share))[:count]


Candidate = tuple[str, str, Setup]


def _tags(setup: Setup) -> Iterator[Candidate]:
    """One more tag in the middle of each gap, and at a bare tip."""
    edges = np.concatenate([[0.0], np.sort(setup.tags)])
    places = 0.5 * (edges[1:] + edges[:-1])[np.diff(edges) > GAP]
    for s in [*places.tolist(), *([1.0] if edges[-1] < 1.0 - GAP else [])]:
        yield "tag", f"one more tag at s = {s:.2f}", replace(setup, tags=tuple(sorted((*setup.tags, round(s, 3)))))
    if len(places) > 1:
        more = tuple(sorted((*setup.tags, *(round(float(s), 3) for s in places))))
        yield "tag", f"{len(places)} more tags, in the middle of every gap", replace(setup, tags=more)


def _pushes(setup: Setup) -> Iterator[Candidate]:
    """The first push made otherwise, and one more push."""
    first = setup.pushes[0]
    bench = replace(instruments(setup).bench, curvature=sharpest(setup))
    places = tuple(s for s in AT_S if s >= min(setup.tags))
    side = 1.0 if np.sin(first.direction) >= 0.0 else -1.0
    for reach in largest_pushes(setup.beam, bench, places, side * np.deg2rad(DIRECTIONS_DEG), LIMITS):
        for size in SIZES if not reach.why_not else ():
            push = replace(first, at_s=reach.at_s, direction=reach.direction, peak=size * reach.largest)
            words = push_words(push)
            try:
                yield "push", f"push {words} instead", replace(setup, pushes=(push, *setup.pushes[1:]))
                yield "second push", f"a second push {words}", replace(setup, pushes=(*setup.pushes, push))
            except RecordingError:
                continue  # the setup itself would be refused
    yield "second push", "the same push once more", replace(setup, pushes=(*setup.pushes, first))


def sharpest(setup: Setup) -> float:
    """rad: the largest |q - q0| of the pushes that are planned."""
    bench, bent = instruments(setup).bench, []
    for push in setup.pushes:
        solved = solve_push(setup.beam, bench, even_push(push))
        bent.append(float(np.max(np.abs(solved.q - solved.problem.q0))))
    return max(bent)


def _instruments(setup: Setup) -> Iterator[Candidate]:
    """Better sensors, tolerances and clocks."""
    sensor = setup.sensor
    if sensor.gain_sd > GAIN_SD:
        known = replace(sensor, gain_sd=GAIN_SD)
        yield "gain", "calibrate the force with a known weight, to 1 %", replace(setup, sensor=known)
    if sensor.gain_sd > WRIST.gain_sd or sensor.reversal > 0.0:
        yield "sensor", "a six-axis force sensor at the wrist", replace(setup, sensor=WRIST)
    elif any(getattr(sensor, name) > 0.0 for name in _SENSOR_SIZES):
        yield "sensor", f"a force sensor {BETTER:g} times as good", replace(setup, sensor=better(sensor))
    seated = replace(setup, placement_sd=setup.placement_sd / BETTER, turn_sd=setup.turn_sd / BETTER)
    turn = np.rad2deg(seated.turn_sd)
    words = f"place the tags to {1e3 * seated.placement_sd:.2g} mm and {turn:.2g} deg (printed carriers)"
    yield "placement", words, seated
    if not setup.clock_sd <= SYNCHRONISED:  # NaN: found from the data
        yield "clock", f"clocks known to {1e3 * SYNCHRONISED:g} ms", replace(setup, clock_sd=SYNCHRONISED)
    sharp = replace(setup.noise, white_xy=0.5 * setup.noise.white_xy, white_angle=0.5 * setup.noise.white_angle)
    yield "camera", "a picture of twice the pixels a millimetre, or tags twice as large", replace(setup, noise=sharp)


def better(sensor: ForceSensor) -> ForceSensor:
    """A sensor whose every error is `BETTER` times smaller."""
    return replace(sensor, **{name: getattr(sensor, name) / BETTER for name in _SENSOR_SIZES})


def push_words(push: PushProfile) -> str:
    """Where, which way, how hard."""
    return f"at s = {push.at_s:.2f}, {direction_words(push.direction)}, to {push.peak:.2g} N"


def _distinct(ranked: list[SetupChange]) -> tuple[SetupChange, ...]:
    """Without near-duplicates and changes that hardly help."""
    kept: list[SetupChange] = []
    for change in ranked:
        alike = [k for k in kept if k.kind == change.kind]
        near = [k for k in alike if "push" in k.kind and abs(_last(k) - _last(change)) < APART]
        if change.share >= LEAST_SHARE and len(alike) < 2 and not near:
            kept.append(change)
    return tuple(kept)


def _last(change: SetupChange) -> float:
    """Place of the push that a change is about."""
    return change.setup.pushes[0 if change.kind == "push" else -1].at_s
