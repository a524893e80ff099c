"""A beam pushed in thought: markers and a force log with known clocks, noise and mistakes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from onebend.records import Array, ForceLog, Markers
from tests.made_up import BEAM, MARKER_S, TAGS

FORCE = np.array([-0.35, 0.3])  # N at the largest push
TABLE = 200


@cache
def table() -> tuple[Array, Array, Array]:
    """Part of the largest push, and the markers' places and angles under it."""
    part = np.linspace(0.0, 1.0, TABLE)
    shape = BEAM.equilibrium(part[:, None] * FORCE * np.stack([part, np.ones(TABLE)], axis=1), np.ones(TABLE))
    return part, shape.xy(MARKER_S), shape.angle(MARKER_S)


def force_at(part: Array) -> Array:
    """(N, 2) N; its direction changes with its size, as the tool goes round."""
    return np.asarray(part[:, None] * FORCE * np.stack([part, np.ones(len(part))], axis=1))


def push(time: Array, begin: float = 1.5, rise: float = 2.0, hold: float = 1.0) -> Array:
    """Part of the largest push: a smooth rise, a hold and a release as long as the rise."""
    up = np.clip((time - begin) / rise, 0.0, 1.0)
    down = np.clip((time - begin - rise - hold) / rise, 0.0, 1.0)
    return np.asarray(up**3 * (10 - 15 * up + 6 * up**2) - down**3 * (10 - 15 * down + 6 * down**2))


@dataclass(frozen=True)
class Pushed:
    """One recording: `log time = video time + offset`."""

    offset: float = 250.3  # s
    fps: float = 30.0
    film: float = 8.0  # s
    rate: float = 200.0  # Hz of the log
    before: float = 1.2  # s, log ahead of the film
    after: float = 0.8  # s
    white: float = 0.02  # N
    coloured: float = 0.006  # N
    tau: float = 0.12  # s
    bias: tuple[float, float] = (0.15, -0.2)  # N
    drift: tuple[float, float] = (0.0, 0.0)  # N/s
    rise: float = 2.0  # s
    hold: float = 1.0  # s
    seed: int = 0

    def markers(self, *, turn: float = 0.0, jitter: float = 0.0) -> Markers:
        """Seen from a base tag turned by `turn` [rad]; frame times off even ones by up to `jitter` of a frame."""
        rng = np.random.default_rng(self.seed)
        time = np.arange(int(self.film * self.fps)) / self.fps
        time[1:] += jitter / self.fps * rng.uniform(-0.5, 0.5, len(time) - 1)
        part, xy, angle = table()
        now = push(time, rise=self.rise, hold=self.hold)
        places = np.stack([np.interp(now, part, column) for column in xy.reshape(TABLE, -1).T], axis=1)
        angles = np.stack([np.interp(now, part, column) for column in angle.T], axis=1)
        places = places.reshape(len(time), -1, 2) + 2e-5 * rng.standard_normal((len(time), len(TAGS), 2))
        angles = angles + 2e-3 * rng.standard_normal(angles.shape)
        back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        covariance = np.broadcast_to(np.diag([4e-10, 4e-10, 4e-6]), (len(time), len(TAGS), 3, 3)).copy()
        still = np.zeros(len(time))
        return Markers(time, TAGS, MARKER_S, places @ back.T, angles - turn, covariance, still, None)

    def log(self) -> ForceLog:
        """In the beam's axes, acting on the beam."""
        rng = np.random.default_rng(1000 + self.seed)
        time = np.arange(-self.before, self.film + self.after, 1 / self.rate)
        keep = np.exp(-1 / self.rate / self.tau)
        slow = np.zeros((len(time), 2))
        kicks = self.coloured * np.sqrt(1 - keep**2) * rng.standard_normal(slow.shape)
        slow[0] = self.coloured * rng.standard_normal(2)
        for i in range(1, len(time)):
            slow[i] = keep * slow[i - 1] + kicks[i]
        wrong = slow + self.white * rng.standard_normal(slow.shape) + self.bias + time[:, None] * self.drift
        return ForceLog(time + self.offset, self.true_force(time) + wrong)

    def true_force(self, time: Array) -> Array:
        """(N, 2) N at `time` [s, video clock]."""
        return force_at(push(time, rise=self.rise, hold=self.hold))
