"""What is asked of the beam as a force sensor, and what it says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from onebend.learning.sensing.edges import Edge
from onebend.learning.sensing.joint import Misfit
from onebend.learning.sensing.sensor import SensorCheck
from onebend.learning.sensing.smooth import Smoothed
from onebend.records import Array, BoolArray, IntArray, Remark


@dataclass(frozen=True)
class SenseSettings:
    """What is known of the contact, and of forces before any shape was seen."""

    place: Literal["known", "unknown"] = "known"
    at_s: float | None = None  # where the force acts; None: as the recording says
    at_sd: float | None = None  # m, one sd of that place; None: as the recording says
    # N, one sd of each component before the shape is seen, mean zero; None: three times k/L, mean along the beam
    force_prior: float | None = None
    # whether the tags sit on the beam as they did when it was learned; "anew": they were put on again
    tags: Literal["learned", "anew"] = "learned"
    smooth: bool = False  # whether the force is told as a process over the frames besides


@dataclass(frozen=True)
class Touch:
    """A stretch of frames that show a force."""

    first: float  # s, of its frames
    last: float  # s
    begin: Edge  # when the force became more than zero
    end: Edge  # and when it was zero again

    @property
    def span(self) -> tuple[float, float]:
        """s, from when to when; where that is not known, of the frames."""
        begin = self.begin.time if math.isfinite(self.begin.sd) else self.first
        end = self.end.time if math.isfinite(self.end.sd) else math.nextafter(self.last, math.inf)
        return begin, end


@dataclass(frozen=True)
class Sensed:
    """The force on the beam in T frames, beam's frame; NaN where a frame tells nothing."""

    name: str
    settings: SenseSettings
    prior_sd: float  # N
    frame: IntArray  # (T,) index in the video
    time: Array  # (T,) s
    force: Array  # (T, 2) N
    covariance: Array  # (T, 2, 2) N^2
    prior_share: Array  # (T, 2) of each component's prior variance, what the data leave: 1 is the prior alone
    place: Array  # (T,) s; NaN where it was sought and not found
    place_sd: Array  # (T,) of s
    other_place: Array  # (T,) s that explains the frame about as well; NaN where there is none
    weak_angle: Array  # (T,) rad, the direction in which the force is known least, against x, in [0, pi)
    weak_sd: Array  # (T,) N, in that direction
    strong_sd: Array  # (T,) N, across it
    chi2: Array  # (T,) squared residuals in units of all noise
    touched: BoolArray  # (T,) zero force lies outside the 95 % region
    contacts: tuple[Touch, ...]
    misfit: Misfit | None  # None: no frame shows a force
    logged: Array  # (T, 2) N, as the recording's log says; NaN where it has none
    # (T, 2, r) N, of the errors what frames have in common: what one sd of each way in which the bench is off does
    common: Array
    smoothed: Smoothed | None = None  # with what neighbouring frames say, where that was asked for
    sensor: SensorCheck | None = None  # the log, judged by this; None: too little of it, or forces not to be trusted
    remarks: tuple[Remark, ...] = ()

    @property
    def peak(self) -> int | None:
        """Index of the largest force among the frames of a contact; None where there is none."""
        inside = np.zeros(len(self.time), dtype=bool)
        for one in self.contacts:
            inside |= (self.time >= one.first) & (self.time <= one.last)
        size = np.where(inside & self.touched, np.hypot(*self.force.T), -1.0)
        return int(np.argmax(size)) if np.any(size > 0.0) else None

    @property
    def against_log(self) -> tuple[float, float] | None:
        """N, RMS over the touched frames of the difference to the log: in the direction in which the force is known
        best, and in that in which least. None where there is no log, or no frame that shows a force."""
        shown = self.touched & np.isfinite(self.logged).all(axis=1)
        if not np.any(shown):
            return None
        away, angle = (self.force - self.logged)[shown], self.weak_angle[shown]
        least = away[:, 0] * np.cos(angle) + away[:, 1] * np.sin(angle)
        best = away[:, 1] * np.cos(angle) - away[:, 0] * np.sin(angle)
        return float(np.sqrt(np.mean(best**2))), float(np.sqrt(np.mean(least**2)))

    def along(self, angle: Array | float) -> tuple[Array, Array]:
        """(T,) N each: the force in the direction `angle` [rad] against x, and its sd."""
        way = np.broadcast_to(np.stack([np.cos(angle), np.sin(angle)], axis=-1), self.force.shape)
        variance = np.einsum("tc,tcd,td->t", way, self.covariance, way)
        return np.einsum("tc,tc->t", way, self.force), np.sqrt(variance)
