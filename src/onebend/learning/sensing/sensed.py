"""What is asked of the beam as a force sensor, and what it says."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from onebend.errors import LearningError
from onebend.learning.endings.edge import Edge
from onebend.learning.sensing.joint import Misfit
from onebend.learning.sensing.sensor import SensorCheck
from onebend.learning.sensing.smooth import Smoothed
from onebend.learning.sensing.two import TwoContacts
from onebend.records import Array, BoolArray, IntArray, Observations, Remark

TOO_FAR, UNLIKELY = 2.5, 1e-4  # of the misfit: its ratio and probability from which no force explains the shapes
WIDE = 1.96  # sds of a 95 % band
FROM_PRIOR = 0.25  # share of a variance left by the data from which it is said


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
    moment: bool = False  # whether the contact transmits a moment besides
    moment_prior: float | None = None  # N m, one sd of it before the shape is seen; None: the force's times L
    contacts: Literal["1", "2", "auto"] = "1"  # auto: two where the evidence is for it
    second_s: float | None = None  # where the second of two forces acts that are said
    smooth: bool = False  # whether the force is told as a process over the frames besides


def check_settings(settings: SenseSettings, name: str, length: float) -> None:
    """Of the recording `name`, of a beam of so many metres.

    Raises:
        LearningError: what is asked contradicts itself, or is not known to act.
    """
    for at in (settings.at_s, settings.second_s):
        if at is not None and not 0.0 < at <= 1.0:
            raise LearningError(f"a force acts at s in (0, 1], got {at}")
    if settings.place == "unknown" and not (settings.at_s is None and settings.at_sd is None):
        raise LearningError("the place of the contact is either said or sought: leave out where it is, or 'unknown'")
    sds = (("the place's sd", settings.at_sd), ("the force's prior sd", settings.force_prior))
    for what, value in (*sds, ("the moment's prior sd", settings.moment_prior)):
        if value is not None and not (math.isfinite(value) and value >= 0.0):
            raise LearningError(f"{what} must be a finite number above zero, got {value}")
    if settings.at_sd is not None and settings.at_sd > length:
        raise LearningError("the place's sd is more than the beam's length: let the place be sought (--place unknown)")
    if settings.force_prior == 0.0:
        raise LearningError("a force prior of 0 N says that there is no force: give the size of forces to be expected")
    if settings.moment_prior == 0.0:
        raise LearningError("a moment prior of 0 N m says that there is no moment: ask for none")
    _check_contacts(settings, name)


def _check_contacts(settings: SenseSettings, name: str) -> None:
    if settings.moment and (settings.place == "unknown" or settings.contacts != "1"):
        raise LearningError(
            "a moment is told of one contact whose place is said: a force elsewhere looks much like a force with a "
            "moment. Say the place (--push-at), and ask for one contact"
        )
    if settings.contacts != "1" and settings.smooth:
        raise LearningError("a smooth force is told of one contact: ask for --smooth or for --contacts, not for both")
    if settings.moment_prior is not None and not settings.moment:
        raise LearningError("a moment's prior is given, and no moment is asked for: add --moment, or leave it out")
    if settings.second_s is not None and settings.contacts == "1":
        raise LearningError("where a second force acts is said, and one contact is asked for: add --contacts 2")
    if settings.second_s is not None and settings.place == "unknown":
        raise LearningError("the places are sought (--place unknown): leave out where the second force acts")
    if settings.contacts != "1" and settings.place == "known" and settings.second_s is None:
        raise LearningError(
            f"{name}: nobody says where the second force acts. Give its place (--second-at), or let both be sought "
            "(--place unknown)"
        )


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


def joined(contacts: Sequence[Touch]) -> tuple[Touch, ...]:
    """Contacts of which the next would begin before the last has ended are one."""
    out: list[Touch] = []
    for one in contacts:
        if out and one.span[0] <= out[-1].span[1]:
            out[-1] = Touch(out[-1].first, one.last, out[-1].begin, one.end)
        else:
            out.append(one)
    return tuple(out)


@dataclass(frozen=True)
class ToldMoment:
    """The moment that a contact puts on the beam besides its force, in T frames."""

    moment: Array  # (T,) N m
    sd: Array  # (T,) N m
    with_force: Array  # (T, 2) N^2 m, covariance with the components of the force
    prior_sd: float  # N m
    prior_share: Array  # (T,) of the prior's variance, what the data leave


@dataclass(frozen=True)
class SecondForce:
    """The second of two forces, the farther one from the clamp where both were sought, in T frames."""

    force: Array  # (T, 2) N
    covariance: Array  # (T, 2, 2) N^2
    with_first: Array  # (T, 2, 2) N^2, covariance of the first force's components with its own
    prior_share: Array  # (T, 2)
    place: float  # s; NaN where it was sought and not found
    place_sd: float  # of s
    touched: BoolArray  # (T,) zero force lies outside its 95 % region


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
    moment: ToldMoment | None = None  # where one was asked for
    two: TwoContacts | None = None  # one contact against two, where that was asked for
    second: SecondForce | None = None  # where two contacts were asked for, or found
    sensor: SensorCheck | None = None  # the log, judged by this; None: too little of it, or forces not to be trusted
    remarks: tuple[Remark, ...] = ()

    @property
    def explained(self) -> bool:
        """Whether the force explains the shapes; true where no frame shows one."""
        return self.misfit is None or self.misfit.ratio <= TOO_FAR or self.misfit.probability >= UNLIKELY

    @property
    def peak(self) -> int | None:
        """Index of the largest force among the frames of a contact, as far as it is sure (the lower end of its 95 %
        band); None where there is none."""
        inside = np.zeros(len(self.time), dtype=bool)
        for one in self.contacts:
            inside |= (self.time >= one.first) & (self.time <= one.last)
        if not np.any(inside & self.touched):
            return None
        size = np.hypot(*self.force.T)
        sd = np.sqrt(np.einsum("tc,tcd,td->t", self.force, self.covariance, self.force)) / np.maximum(size, 1e-300)
        return int(np.nanargmax(np.where(inside & self.touched, size - WIDE * sd, np.nan)))

    @property
    def against_log(self) -> tuple[float, float] | None:
        """N, RMS over the touched frames of the difference to the log: in the direction in which the force is known
        best, and in that in which least. None where there is no log, no frame that shows a force, or a second one, of
        which the log may be."""
        if self.second is not None:
            return None
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


def logged_forces(o: Observations) -> Array:
    """(T, 2) N of the log; NaN where there is none."""
    none = o.source.clean_force is None and not np.any(o.force)
    return np.full_like(o.force, np.nan) if none else o.force


def sensed_remarks(sensed: Sensed, o: Observations, *, banded: bool) -> tuple[Remark, ...]:
    """What the regions do not hold, and what is not observable; `banded`: the model has a band on k(s)."""
    out, fit, lost = [], sensed.misfit, int(np.sum(np.isnan(sensed.force[:, 0])))
    if fit is not None and not sensed.explained:
        text = (
            f"No force explains the shapes: the tags are {math.sqrt(fit.ratio):.2g} times as far off as k(s)'s band, "
            "mounting and noise allow, so the forces are not to be trusted. Check that the model is of this beam, that "
            "it stands in its clamp as it did then, where the force acts, and that the push is slow"
            + ("" if sensed.settings.force_prior is None else ". Or --force-prior-N is far too small for this force")
        )
        out.append(Remark("warning", text, about="sensed misfit"))
    if sensed.sensor is not None and not sensed.sensor.scale_agrees(o.stated.gain_sd):
        gain, sd = sensed.sensor.gain
        text = (
            f"The log shows {gain:.3g} ± {WIDE * sd:.2g} times the force that the shape tells: the sensor's scale is "
            "off, or the model's k(s) is by as much, which no shape tells. A weight hung on the beam tells which"
        )
        out.append(Remark("warning", text, about="sensed gain"))
    if not banded:
        out.append(Remark("note", "The model has no band on k(s): the regions hold noise and mounting alone."))
    if not np.isfinite(o.rest_xy).any():
        out.append(Remark("note", "No frame shows the beam at rest: the mounting is known only as stated."))
    if not o.sd_known:
        out.append(Remark("note", "The tags' noise is a guess, and the regions are as good as it is."))
    if lost:
        out.append(Remark("note", f"In {lost} frames no equilibrium was found that explains the tags."))
    if np.any(sensed.touched):
        share = np.nanmedian(sensed.prior_share[sensed.touched], axis=0)
        weak = [f"{name} ({100 * one:.0f} %)" for name, one in zip("xy", share, strict=True) if one > FROM_PRIOR]
        if weak:
            text = (
                f"The force along {' and '.join(weak)} comes in good part from the prior (sd {sensed.prior_sd:.3g} N)."
            )
            out.append(Remark("note", text))
    return (*out, *load_remarks(sensed))


def load_remarks(sensed: Sensed) -> list[Remark]:
    """What is not observable of a moment, and how sure two contacts are."""
    out, two, moment = [], sensed.two, sensed.moment
    if moment is not None and np.any(sensed.touched):
        share = float(np.nanmedian(moment.prior_share[sensed.touched]))
        if share > FROM_PRIOR:
            out.append(
                f"The moment comes in good part ({100 * share:.0f} %) from the prior (sd {moment.prior_sd:.3g} N m)."
            )
    if two is not None and not two.found:
        asked = "" if sensed.second is None else ", and two were asked for: the second force may be none"
        out.append(f"The shapes show one contact (log evidence of a second {two.evidence:.3g}){asked}.")
    if two is not None and two.others and sensed.second is not None:
        pairs = " or ".join(f"s = {near:.2f} and {far:.2f}" for near, far in (two.places, *two.others))
        out.append(
            f"The shapes do not tell which places two contacts have: {pairs}. The forces are those of the first."
        )
    return [Remark("note", text) for text in out]
