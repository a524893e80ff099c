"""How the paper's experiments are reproduced: beams, pushes, and the robot's force estimate."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from math import radians
from typing import Any, Literal, get_args

import numpy as np

from onebend.errors import RecordingError
from onebend.lab.designs import DESIGNS, Design
from onebend.lab.film_request import FilmRequest, PushName, filming_of
from onebend.lab.filming.film_setup import Filming
from onebend.lab.sensors import FRANKA, ForceSensor

SensorKind = Literal["paper", "franka"]
BEAMS = ("linear", "quadratic", "cubic")
REST = 2.0  # s, before and after a push
# N: the slow parts of the error, the only sizes that are not a Franka's own. Its 0.22 N after each turn of the load,
# measured at 3 to 7 N, would move the tips of these beams by 15 mm and more; the paper smoothed its logs, is off by 2
# to 3 mm in training, and says that the force is to blame. With these, the three true beams under the logged forces of
# the training push are off by as much at the tip (RMS over beams and seeds).
COLOURED = 0.014
REVERSAL = 0.007


@dataclass(frozen=True)
class Strategy:
    """A way to push, Section IV-D. The first trains, the others validate."""

    name: PushName
    says: str
    bend: float  # rad, turn of the pushed place at the peak
    seconds: float  # from first to last contact
    quick: float  # s, the same where it is to be quick


# The paper prints neither forces nor times, but: the fast push is 2 to 3 times as fast; those at 0.8 and 0.6 bend less.
STRATEGIES = (
    Strategy("slow", "slow, at the tip", radians(65.0), 7.0, 6.0),
    Strategy("fast", "fast, at the tip", radians(65.0), 2.8, 2.6),
    Strategy("s08", "slow, at s = 0.8", radians(55.0), 6.0, 4.0),
    Strategy("s06", "slow, at s = 0.6", radians(40.0), 6.0, 4.0),
)


@dataclass(frozen=True)
class StudySettings:
    """Settings of one study. With the version they determine its results."""

    seed: int = 0
    quick: bool = False  # shorter pushes and fewer frames/s
    video: bool = True  # False: the tags' poses with a camera's noise, no picture
    sensor: SensorKind = "paper"

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise RecordingError(f"a seed is a whole number of at least 0, got {self.seed}")
        if self.sensor not in get_args(SensorKind):
            raise RecordingError(f"there is no sensor {self.sensor!r}. Take one of {', '.join(get_args(SensorKind))}.")

    @property
    def fps(self) -> float:
        """Frames/s."""
        return 12.0 if self.quick else 30.0

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def gain_of(setting: StudySettings) -> float:
    """The gain of the robot's force estimate: one robot, one gain in all twelve logs."""
    rng = np.random.default_rng([setting.seed, 30])
    return float(np.exp(FRANKA.gain_sd * rng.standard_normal()))


def sensor_of(setting: StudySettings) -> ForceSensor:
    """The robot's estimate of the force: noisy and biased (Section VI-B).

    `paper`: a Franka's white noise, bias, lag and lost rows, with slow errors as large as the paper's own training
    errors leave room for. `franka`: with the slow errors that were measured on such a robot.
    """
    sensor = replace(FRANKA, gain=gain_of(setting), gain_sd=0.0)
    return sensor if setting.sensor == "franka" else replace(sensor, coloured_sd=COLOURED, reversal=REVERSAL)


def seen_through(design: Design, gain: float) -> Design:
    """The design with `gain` times its k(s): what a force log with this gain shows."""
    return replace(design, modulus=gain * design.modulus)


def filmed_push(setting: StudySettings, beam: str, strategy: Strategy) -> Filming:
    """One of the twelve recordings."""
    seconds = strategy.quick if setting.quick else strategy.seconds
    request = FilmRequest(push=strategy.name, bend=strategy.bend, seconds=seconds, fps=setting.fps)
    asked = filming_of(DESIGNS[beam], request, name_of(beam, strategy))
    push = replace(asked.bench.push, before=REST, after=REST)
    return replace(asked, bench=replace(asked.bench, push=push, sensor=sensor_of(setting)))


def name_of(beam: str, strategy: Strategy) -> str:
    """Name of a recording."""
    return f"{beam}-{strategy.name}"


def seed_of(setting: StudySettings, beam: str, strategy: Strategy) -> int:
    """A seed of its own for every recording."""
    place = BEAMS.index(beam) * len(STRATEGIES) + [strategy.name for strategy in STRATEGIES].index(strategy.name)
    return int(np.random.SeedSequence([setting.seed, 31, place]).generate_state(1)[0])
