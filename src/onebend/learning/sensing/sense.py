"""The beam as a force sensor: the force on a beam whose k(s) is known, from its shape, frame by frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.setup import SetUp
from onebend.beam.stiffness import UncertainStiffness
from onebend.errors import LearningError
from onebend.learning.force_error import force_error
from onebend.learning.outcome import Notice
from onebend.learning.sensing import forces, model
from onebend.learning.sensing.contacts import Edge, contacts_of, excursion_of, runs_of
from onebend.learning.sensing.model import Bench
from onebend.learning.sensing.sensor import FEWEST, SensedForces, SensorCheck, check_sensor
from onebend.options import NOT_NEGATIVE, POSITIVE, option
from onebend.progress import one_blas_thread
from onebend.records import Array, BoolArray, IntArray, Observations

# What is asked of the beam as a force sensor, and what it says.

TOO_FAR, UNLIKELY = 2.5, 1e-4  # of the misfit: its ratio and probability from which no force explains the shapes
WIDE = 1.96  # sds of a 95 % band
FROM_PRIOR = 0.25  # share of a variance left by the data from which it is said


@dataclass(frozen=True)
class SenseSettings:
    """What is known of the contact, and of forces before any shape was seen."""

    place: Literal["known", "unknown"] = option("--place", "known")
    at_s: float | None = option("--push-at", None, metavar="S", within=(1e-6, 1.0))
    at_sd: float | None = option("--push-sd-m", None, within=NOT_NEGATIVE)
    force_prior: float | None = option("--force-prior-N", None, within=POSITIVE)
    tags: Literal["learned", "anew"] = option("--tags", "learned")
    moment: bool = option("--moment", False)
    moment_prior: float | None = option("--moment-prior-Nm", None, within=POSITIVE)


def check_settings(settings: SenseSettings, length: float) -> None:
    """Of a beam of `length` [m].

    Raises:
        LearningError: what is asked contradicts itself, or is not known to act.
    """
    if settings.at_s is not None and not 0.0 < settings.at_s <= 1.0:
        raise LearningError(f"a force acts at s in (0, 1], got {settings.at_s}")
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
    if settings.moment and settings.place == "unknown":
        raise LearningError(
            "a moment is told of a contact whose place is said: a force elsewhere looks much like a force with a "
            "moment. Say the place (--push-at)"
        )
    if settings.moment_prior is not None and not settings.moment:
        raise LearningError("a moment's prior is given, and no moment is asked for: add --moment, or leave it out")


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
class ContactMoment:
    """The moment that a contact puts on the beam besides its force, in T frames."""

    moment: Array  # (T,) N m
    sd: Array  # (T,) N m
    with_force: Array  # (T, 2) N^2 m, covariance with the components of the force
    prior_sd: float  # N m
    prior_share: Array  # (T,) of the prior's variance, what the data leave


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
    misfit: forces.Misfit | None  # None: no frame shows a force
    logged: Array  # (T, 2) N, as the recording's log says; NaN where it has none
    common: Array  # (T, 2, r) N, change of the force for one sd of each of the r errors that all frames share
    moment: ContactMoment | None = None  # where one was asked for
    sensor: SensorCheck | None = None  # the log, judged by this; None: too little of it, or forces not to be trusted
    remarks: tuple[Notice, ...] = ()

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


def logged_forces(o: Observations) -> Array:
    """(T, 2) N of the log; NaN where there is none."""
    none = o.source.clean_force is None and not np.any(o.force)
    return np.full_like(o.force, np.nan) if none else o.force


def sensed_notices(sensed: Sensed, o: Observations, *, banded: bool) -> tuple[Notice, ...]:
    """What the regions do not hold, and what is not observable; `banded`: the model has a band on k(s)."""
    out, fit, moment = [], sensed.misfit, sensed.moment
    lost = int(np.sum(np.isnan(sensed.force[:, 0])))
    if fit is not None and not sensed.explained:
        free = sensed.settings.force_prior is None
        out.append(Notice("no force" if free else "no force of this size", {"times": math.sqrt(fit.ratio)}))
    if sensed.sensor is not None and not sensed.sensor.scale_agrees(o.stated.gain_sd):
        gain, sd = sensed.sensor.gain
        out.append(Notice("sensed gain", {"gain": gain, "wide": WIDE * sd}))
    out += [] if banded else [Notice("sensed without a band")]
    out += [] if np.isfinite(o.rest_xy).any() else [Notice("sensed without a rest")]
    out += [] if o.sd_known else [Notice("sensed with guessed noise")]
    out += [Notice("sensed not everywhere", {"lost": lost})] if lost else []
    if np.any(sensed.touched):
        share = np.nanmedian(sensed.prior_share[sensed.touched], axis=0)
        weak = [f"{name} ({100 * one:.0f} %)" for name, one in zip("xy", share, strict=True) if one > FROM_PRIOR]
        if weak:
            out.append(Notice("force from the prior", {"axes": " and ".join(weak), "sd": sensed.prior_sd}))
        if moment is not None and (part := float(np.nanmedian(moment.prior_share[sensed.touched]))) > FROM_PRIOR:
            out.append(Notice("moment from the prior", {"share": part, "sd": moment.prior_sd}))
    return tuple(out)


PRIOR_SHARE = 3.0  # of k/L: the prior's sd of each component of the force
_NOTHING = 1e-4  # of the prior's sd: a force that is none
_PLACE_KNOWN = 0.1  # sd of s beyond which the place of the contact is not told
_PRIORS = (1e-9, 1e9)  # of the usual sd of a force: beyond, it is none of a beam


@one_blas_thread
def sense(
    beam: Beam,
    observations: Observations,
    *,
    stiffness: UncertainStiffness | None = None,
    setup: SetUp | None = None,
    settings: SenseSettings = SenseSettings(),
) -> Sensed:
    """The force of every frame that shows tags, with a 95 % region, from the shape of `beam`.

    The regions hold the tags' noise, the band of k(s) where `stiffness` gives one, the mounting (the tags' places and
    turns, the clamp, the rest shape) as it is left by the frames at rest, and the place's tolerance. The force log is
    not used but to compare with. `setup` is that in which the beam was learned, with what is new: where the recording
    has the same tags, they are as they were learned, together with the errors of k(s); what the learning left
    unexplained (its discrepancy) counts in any case.

    Raises:
        LearningError: the beam is not that of the recording, its end is held, nobody says where the force acts, or no
            frame shows a tag.
        MechanicsError: k(s) is not positive somewhere.
    """
    o = observations
    bench, priors = bench_of(beam, o, stiffness, setup, settings), priors_of(beam, settings)
    tells: BoolArray = np.sum(np.isfinite(o.xy), axis=(1, 2)) >= 2
    frames = np.flatnonzero(tells).astype(np.int64)
    if not frames.size:
        raise LearningError(f"{o.source.name}: no frame shows a tag of the beam, so no force can be told")
    place = places_of(o, frames, settings) if settings.place == "known" else None

    try:
        return _sensed(forces.search(bench, frames, place, priors), frames, priors, settings)
    except np.linalg.LinAlgError as error:
        raise LearningError(
            f"{o.source.name}: the equations of the force cannot be solved ({error}). Check that the model is of this "
            "beam and as `onebend learn` wrote it"
        ) from error


def priors_of(beam: Beam, settings: SenseSettings) -> Array:
    """(n,) N, N, and N m where a moment is asked for: one sd of each before any shape is seen.

    Raises:
        LearningError: what is asked for is beyond any force on this beam.
    """
    mean_k = float(np.mean(np.asarray(beam.stiffness(np.linspace(0.0, 1.0, 101)))))
    usual = PRIOR_SHARE * mean_k / beam.length
    force = usual if settings.force_prior is None else settings.force_prior
    if settings.force_prior is not None and not _PRIORS[0] < force / usual < _PRIORS[1]:
        raise LearningError(f"a force prior of {force:g} N is beyond any force on this beam; usual is {usual:.3g} N")
    moment = force * beam.length if settings.moment_prior is None else settings.moment_prior
    return np.array([force, force, moment][: 3 if settings.moment else 2])


def bench_of(
    beam: Beam,
    o: Observations,
    stiffness: UncertainStiffness | None,
    setup: SetUp | None,
    settings: SenseSettings,
) -> Bench:
    """The bench as the beam at rest leaves it.

    Raises:
        LearningError: as `sense`.
    """
    check_settings(settings, o.length)
    model.check_recording(beam, o)
    place_sd = o.stated.place_sd if settings.at_sd is None else settings.at_sd
    if settings.place == "unknown":
        place_sd = 0.0
    as_learned = settings.tags == "learned"
    return forces.rested(model.bench_at(beam, o, stiffness, setup, tags_as_learned=as_learned, place_sd=place_sd))


def places_of(o: Observations, frames: IntArray, settings: SenseSettings) -> Array:
    """(F,) where the force acts; frames of which nobody says it take the usual place."""
    if settings.at_s is not None:
        return np.full(len(frames), settings.at_s)
    said = o.push_s[frames]
    if not np.isfinite(said).any():
        raise LearningError(
            f"{o.source.name}: nobody says where the force acts. Write [push] in recording.toml, give its place "
            "(--push-at), or let it be sought (--place unknown)"
        )
    return np.where(np.isfinite(said), said, np.nanmedian(said))


def _sensed(searched: forces.Searched, frames: IntArray, priors: Array, settings: SenseSettings) -> Sensed:
    bench, found, other, prior = searched.bench, searched.found, searched.other_place, float(priors[0])
    n = len(priors)
    o, axes = bench.observations, bench.axes_of_loads(n)
    load, covariance = found.force @ axes.T, axes @ found.covariance[:, :n, :n] @ axes.T
    known: BoolArray = np.asarray(np.isfinite(found.force[:, 0]))
    covariance = np.where(known[:, None, None], covariance, np.nan)
    values, vectors = np.linalg.eigh(np.nan_to_num(covariance[:, :2, :2]))
    touched = forces.touches(found)
    contacts = _over_time(o, frames, touched)
    place, place_sd = _places(searched, settings, known)
    share = np.einsum("tcc->tc", covariance) / priors**2
    out = Sensed(
        name=o.source.name,
        settings=settings,
        prior_sd=prior,
        frame=o.frame[frames],
        time=o.time[frames],
        force=load[:, :2],
        covariance=covariance[:, :2, :2],
        prior_share=share[:, :2],
        place=place,
        place_sd=place_sd,
        other_place=np.where(known & touched, other, np.nan),
        weak_angle=np.where(known, np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]) % np.pi, np.nan),
        weak_sd=np.where(known, np.sqrt(values[:, 1]), np.nan),
        strong_sd=np.where(known, np.sqrt(values[:, 0]), np.nan),
        chi2=np.where(known, found.chi2, np.nan),
        touched=touched,
        contacts=contacts,
        misfit=searched.misfit,
        logged=logged_forces(o)[frames],
        common=(axes @ found.common)[:, :2],
    )
    if n == 3:
        sd = np.sqrt(covariance[:, 2, 2])
        moment = ContactMoment(load[:, 2], sd, covariance[:, :2, 2], float(priors[2]), share[:, 2])
        out = replace(out, moment=moment)
    out = replace(out, sensor=_judged(out, o, frames) if out.explained else None)
    return replace(out, remarks=sensed_notices(out, o, banded=bench.stiffness is not None))


def _places(searched: forces.Searched, settings: SenseSettings, known: BoolArray) -> tuple[Array, Array]:
    """(T,) s of the force and one sd each; NaN where it was sought and not found."""
    bench, found = searched.bench, searched.found
    if settings.place == "unknown":
        place, place_sd = found.place, np.sqrt(found.covariance[:, -1, -1])
        told = known & np.isnan(searched.other_place)
    else:
        place, place_sd = bench.placed(found.place), np.full(len(known), bench.place_sd / bench.observations.length)
        told = known
    return np.where(told & (place_sd < _PLACE_KNOWN), place, np.nan), np.where(known, place_sd, np.nan)


def _judged(out: Sensed, o: Observations, frames: IntArray) -> SensorCheck | None:
    """The log by the force; where nothing touches the beam, that is none, in every direction."""
    if np.sum(np.isfinite(out.logged).all(axis=1)) < FEWEST:
        return None
    bare = ~(o.loaded[frames] | out.touched) & np.isfinite(out.force).all(axis=1)
    force, covariance = np.where(bare[:, None], 0.0, out.force), out.covariance.copy()
    covariance[bare] = (_NOTHING * out.prior_sd) ** 2 * np.eye(2)
    common = np.where(bare[:, None, None], 0.0, out.common)
    told = SensedForces(out.time, force, covariance, common, out.prior_sd)
    clock_sd = 0.0 if o.source.clock is None else o.source.clock.sd
    return check_sensor(told, out.logged, force_error(o, out.time), o.source.clean_force, clock_sd)


def _over_time(o: Observations, frames: IntArray, touched: BoolArray) -> tuple[Touch, ...]:
    """When each contact began and ended."""
    runs, time = runs_of(touched), o.time[frames]
    found = contacts_of(excursion_of(time, o.xy[frames], runs[0][0]), runs) if runs else []
    return joined([Touch(float(time[c.first]), float(time[c.last]), c.begin, c.end) for c in found])


# One frame after the other, each from the force and shape of the one before. Errors that frames share are integrated
# out as they count at this force: near a buckling load that changes much from frame to frame.

_LOST = 20.0  # squared residuals over their count, above the usual: the search begins anew
_ONE = np.zeros(1, dtype=np.int64)


@dataclass(frozen=True)
class LiveForce:
    """The force in one frame, beam's frame; NaN where the frame tells nothing, or no force explains it: then `chi2` is
    more than twenty times the count of what was measured."""

    time: float  # s
    force: Array  # (2,) N
    covariance: Array  # (2, 2) N^2
    place: float  # s
    place_sd: float  # of s
    touched: bool  # zero force lies outside the 95 % region
    chi2: float  # squared residuals in units of all noise


class OnlineSense:
    """Force (and place) of each frame as it comes.

    Stiffness and force together cannot be told without a force log: k(s) stays as it was learned.
    """

    def __init__(
        self,
        beam: Beam,
        at_rest: Observations,
        *,
        stiffness: UncertainStiffness | None = None,
        setup: SetUp | None = None,
        settings: SenseSettings = SenseSettings(),
    ) -> None:
        """`at_rest`: what was seen of the beam with nothing on it, and what is stated of it.

        Raises:
            LearningError: as `sense`.
        """
        o = replace(at_rest, source=replace(at_rest.source, view=None), by_camera=None)
        self._bench = bench_of(beam, o, stiffness, setup, settings)
        every = np.arange(len(o.time), dtype=np.int64)
        self._place = None if settings.place == "unknown" else float(places_of(o, every, settings)[0])
        self._force_sd = priors_of(beam, settings)[:2]
        self._last: forces.Around | None = None  # the frame before

    @one_blas_thread
    def add(self, time: float, xy: Array, angle: Array, covariance: Array) -> LiveForce:
        """The force in a frame at `time` [s]: tags at `xy` (m, 2) [m], `angle` (m,) [rad], with their covariance
        (m, 3, 3); NaN where a tag was not seen."""
        seen = np.concatenate([xy, angle[:, None]], axis=1)[None]
        if np.sum(np.isfinite(xy)) < 2:
            return _no_force(time, np.nan)
        place = np.full(1, np.nan if self._place is None else self._place)
        bench = self._bench.showing(seen, covariance[None])
        frame = forces.FrameModel(bench, _ONE, place, self._force_sd, self._place is None)
        most, found = _LOST * int(np.sum(np.isfinite(seen))), None
        if self._last is not None:
            found, around = frame.followed(self._last.showing(bench.seen[:1], bench.whiten[:1]))
        if found is None or not found.chi2[0] <= most or not np.isfinite(found.force).all():
            begun, _ = forces.first(bench, _ONE, None if frame.seek_place else place, self._force_sd)
            own = np.column_stack([np.nan_to_num(begun.force), begun.place])[:, : len(frame.sd)]
            again, anew = frame.searched(frame.begun(own))
            found, around = (again, anew) if found is None or again.chi2[0] < found.chi2[0] else (found, around)
        chi2 = float(found.chi2[0])
        if not (chi2 <= most and np.isfinite(found.force).all()):
            self._last = None
            return _no_force(time, chi2)
        self._last, axes = around, bench.axes
        force, part = axes @ found.force[0], axes @ found.covariance[0, :2, :2] @ axes.T
        sd = np.sqrt(found.covariance[0, 2, 2]) if frame.seek_place else bench.place_sd / bench.observations.length
        touched = bool(force @ np.linalg.solve(part, force) > forces.TOUCH)
        return LiveForce(time, force, part, float(found.place[0]), float(sd), touched, chi2)


def _no_force(time: float, chi2: float) -> LiveForce:
    none = np.full((2, 2), np.nan)
    return LiveForce(time, none[0], none, np.nan, np.nan, False, chi2)
