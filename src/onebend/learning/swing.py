"""Damping, and k over mass, from a film of the beam swinging freely."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from onebend.beam.dynamics import Actions, Body, body
from onebend.beam.grid import Modes
from onebend.beam.model import Beam
from onebend.beam.stiffness import Profile, Scaled, Table, UncertainStiffness, Uniform
from onebend.beam.vibration import Vibration, settle, vibration_of
from onebend.errors import LearningError, MechanicsError
from onebend.learning.outcome import Notice
from onebend.learning.parameters import Priors
from onebend.learning.swing_frequencies import (
    NYQUIST,
    FilmPart,
    SwingFrequency,
    basis_of,
    first_passage,
    swing_frequencies,
)
from onebend.options import option
from onebend.progress import one_blas_thread
from onebend.records import Array, Observations, tags_among

_MARGIN = 0.1  # s after the last contact found: the tool leaves the beam within it
_STANDS = 0.2  # m/s^2, by which gravity may turn while the base stands


@dataclass(frozen=True)
class Swing:
    """Tags of T frames of free motion, m tags."""

    name: str
    time: Array  # (T,) s since the first of these frames
    begin: float  # s, the first of them on the film's clock
    s: Array  # (m,)
    xy: Array  # (T, m, 2) m, NaN where a tag was not seen
    gravity: Array  # (2,) m/s^2
    rate: float  # frames/s

    def signals(self) -> Array:
        """(T, 2 m) m."""
        return self.xy.reshape(len(self.time), -1)


def find_swing(o: Observations, part: FilmPart = FilmPart()) -> Swing:
    """The free swing after the last contact, or in `part` of the film. Raises `LearningError` where there is no
    release, no tag, or a base that turns."""
    film_time = o.time - (o.source.clock.offset if o.source.clock is not None else 0.0)
    begin = _release(o, film_time) if part.begin is None else part.begin
    chosen = (film_time >= begin) & (film_time <= (np.inf if part.end is None else part.end))
    xy, tags = _watched(o), tags_among(o)
    chosen &= np.isfinite(xy).any(axis=(1, 2))
    if not chosen.any():
        raise LearningError(
            f"{o.source.name}: no frame shows tags from {begin:.2f} s of the film on. Film on after the release until "
            "the beam has almost stopped"
        )
    if np.ptp(o.gravity[chosen], axis=0).max() > _STANDS:
        raise LearningError(
            f"{o.source.name}: the base turns while the beam swings. Let it swing from a base that stands"
        )
    return Swing(
        name=o.source.name,
        time=o.time[chosen] - o.time[chosen][0],
        begin=float(film_time[chosen][0]),
        s=o.marker_s[tags] if tags.any() else o.marker_s,
        xy=xy[chosen],
        gravity=np.asarray(o.gravity[chosen].mean(axis=0)),
        rate=1.0 / float(np.median(np.diff(o.time))),
    )


def _watched(o: Observations) -> Array:
    """(T, m, 2) m, the tags, which every frame may show; without tags the points of the outline."""
    tags = tags_among(o)
    return o.xy[:, tags] if tags.any() else o.xy


def _release(o: Observations, film_time: Array) -> float:
    """s on the film's clock from which the beam is free: from the first regular passage through rest, or after the last
    contact."""
    touched = np.flatnonzero(o.loaded)
    free = first_passage(film_time, _watched(o).reshape(len(film_time), -1))
    if np.isfinite(free):
        return free
    if not len(touched):
        raise LearningError(f"{o.source.name}: no contact was found, so no release. Say when the beam swings: --from-s")
    if touched[-1] == len(o.time) - 1:
        raise LearningError(
            f"{o.source.name}: the beam is pushed to the end of the film. Film on after the release; or, where it "
            "swings freely in a part of the film, say from when on: --from-s"
        )
    return float(film_time[touched[-1]]) + _MARGIN


# The swing's first mode, a damped sinusoid of frequency w and decay d, is compared with the first small vibration of
# the beam about rest, whose stiffness is `c (k + g)`: d = tau c k / 2 with Kelvin-Voigt damping d(s) = tau k(s), and
# w^2 + d^2 = c k + g with the weight's part g. A large swing is no small vibration, air damps it more, and clamps
# slide: the later half of the swing, of half the size, tells by how much, and its difference counts as an sd.


@dataclass(frozen=True)
class _Mode:
    """Square of the undamped frequency, and decay, of a swing's first mode."""

    squared: float  # (rad/s)^2
    decay: float  # 1/s
    squared_sd: float
    decay_sd: float


def _first_mode(swing: Swing) -> tuple[_Mode, tuple[SwingFrequency, ...]]:
    """The largest mode, and all of them."""
    modes = swing_frequencies(swing.time, swing.signals(), name=swing.name).modes
    one = max((mode for mode in modes if not mode.multiple_of), key=lambda mode: mode.share)
    undamped = 2.0 * np.pi * one.frequency / np.sqrt(1.0 - one.damping_ratio**2)
    squared, decay = undamped**2, one.damping_ratio * undamped
    sd = 4.0 * np.pi * undamped * one.sd
    return _Mode(squared, decay, sd, undamped * one.damping_ratio_sd), modes


def _with_later_part(swing: Swing, whole: _Mode) -> _Mode:
    """With what the later part of the swing says otherwise as sd."""
    late = swing.time >= min(np.log(2.0) / max(whole.decay, 1e-9), 0.5 * float(swing.time[-1]))
    try:
        later, _ = _first_mode(replace(swing, time=swing.time[late], xy=swing.xy[late]))
    except LearningError:  # too short, or too small
        return whole
    return replace(
        whole,
        squared_sd=float(np.hypot(whole.squared_sd, later.squared - whole.squared)),
        decay_sd=float(np.hypot(whole.decay_sd, later.decay - whole.decay)),
    )


def scaled(on: Body, factor: float, loss_time: float, *, mass_known: bool) -> Body:
    """With k over mass times `factor`: by k where the mass is known, else by the mass; and damping tau k."""
    if mass_known:
        stiff = factor * on.stiffness
        return replace(on, stiffness=stiff, damping=loss_time * stiff)
    mass = 1.0 / factor
    return replace(
        on, carried=mass * on.carried, lever=mass * on.lever, mass=mass * on.mass, damping=loss_time * on.stiffness
    )


def _of_bending(found: Vibration) -> Array:
    """(m,) (rad/s)^2: what the beam's stiffness adds to the squared frequencies; the rest is of its weight."""
    return np.asarray(np.einsum("ni,nm,mi->i", found.shapes, found.body.stiffness, found.shapes))


def _matched(on: Body, swing: Swing, squared: float, *, mass_known: bool) -> tuple[float, Vibration]:
    """The factor on k over mass with which the slowest vibration is as fast as the swing, and the vibrations."""
    factor = 1.0
    for _ in range(6):
        found = _vibration(scaled(on, factor, 0.0, mass_known=mass_known), swing)
        step = (squared - found.squared[0]) / _of_bending(found)[0]
        factor *= max(1.0 + float(step), 0.2)
        if abs(step) < 1e-9:
            break
    return factor, _vibration(scaled(on, factor, 0.0, mass_known=mass_known), swing)


def _off_shape(swing: Swing, modes: tuple[SwingFrequency, ...], about: Vibration) -> tuple[Array, Array]:
    """(m,) m RMS over a swing: by what each tag's first mode differs from the beam's, and its size. NaN: not seen."""
    ordered = sorted(modes, key=lambda mode: -mode.share)
    pairs = [(2.0 * np.pi * mode.frequency, mode.damping_ratio * 2.0 * np.pi * mode.frequency) for mode in ordered]
    signals, basis = swing.signals(), basis_of(swing.time, pairs)
    sizes = np.full(signals.shape[1], np.nan, dtype=complex)
    for c, known in enumerate(np.isfinite(signals).T):
        if known.sum() > basis.shape[1]:
            cos, sin = np.linalg.lstsq(basis[known], signals[known, c], rcond=None)[0][2:4]
            sizes[c] = cos - 1j * sin
    seen, shape = sizes.reshape(-1, 2), about.moved(swing.s)[0]
    there = np.isfinite(seen).all(axis=1)
    along = np.sum(shape[there] * seen[there]) / np.sum(shape[there] ** 2)
    return np.linalg.norm(seen - along * shape, axis=1) / np.sqrt(2.0), np.linalg.norm(seen, axis=1) / np.sqrt(2.0)


MassAlong = Literal["even", "width"]

_DRAWS = 60  # of k(s) and of the mass, for what they do to the frequency
_CONTRADICTS = 3.0  # sd by which c differs from 1 before it is called a contradiction
_HARDLY = 0.3  # relative sd of the loss time beyond which it is hardly known
_FAR_OFF = 0.1  # of a tag's own motion (RMS): further from that of the model's mode, the model is said to be wrong
_GRID = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True)
class DampingSettings:
    """How the swing is fitted."""

    mass_along: MassAlong = option(
        "--mass-along",
        "even",
        "How a mass known only as a whole lies along the beam. even; width: as the third root of k, as where only "
        "the width in the plane of bending varies.",
    )
    modes: int = 10  # curvature modes of the beam
    seed: int = 0  # of the draws


@dataclass(frozen=True)
class Damping:
    """How the beam's motion dies, as `model.json` keeps it."""

    loss_time: float  # tau = d / k, s
    loss_time_sd: float  # s
    frequency: tuple[float, ...]  # Hz, natural (undamped) ones of small vibrations about rest, slowest first
    frequency_sd: float  # Hz, of the first
    ratio: tuple[float, ...]  # damping ratio of each; pi f tau where no weight acts
    ratio_sd: float  # of the first
    recording: str

    def as_dict(self) -> dict[str, Any]:
        """Plain data from which `Damping.from_dict` makes an equal one."""
        return {key + _UNITS.get(key, ""): value for key, value in asdict(self).items()}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Damping:
        """Inverse of `as_dict`. Raises `LearningError` for an entry that is missing, unknown or without meaning."""
        names = {key + _UNITS.get(key, ""): key for key in cls.__dataclass_fields__}
        if set(data) != set(names):
            raise LearningError(f"must have the keys {', '.join(names)}")
        try:
            one = {
                key: float(data[name]) for name, key in names.items() if key not in ("frequency", "ratio", "recording")
            }
            frequency, ratio = (tuple(float(v) for v in data[name]) for name in ("frequency_Hz", "ratio"))
        except (TypeError, ValueError) as error:
            raise LearningError(f"holds no number where one should be ({error})") from error
        found = cls(frequency=frequency, ratio=ratio, recording=str(data["recording"]), **one)
        numbers = (found.loss_time, *found.frequency, *found.ratio, found.loss_time_sd, found.frequency_sd)
        if not (np.all(np.isfinite(numbers)) and min(numbers) >= 0.0 and found.loss_time > 0.0 and found.frequency):
            raise LearningError("holds a number without meaning")
        return found


_UNITS = {"loss_time": "_s", "loss_time_sd": "_s", "frequency": "_Hz", "frequency_sd": "_Hz"}


@dataclass(frozen=True)
class SwingFit:
    """What a free swing says."""

    beam: Beam  # with the mass that it swings with
    damping: Damping
    mass_known: bool
    factor: float  # c: k over mass as it swings, over the model's; 1 by choice where the mass was unknown
    factor_sd: float  # from the swing alone; NaN where the mass was unknown
    model_sd: float  # relative sd of the model's own, from the band on k and how the mass lies; NaN without a band
    mass: float  # kg, the model's; what makes the frequency right where it was unknown
    mass_sd: float  # kg; NaN where the mass was known
    swing: Swing
    rms: Array  # (m,) m over a swing, by which a tag moves otherwise than in the model's first mode
    remarks: tuple[Notice, ...]


@one_blas_thread
def learn_damping(
    beam: Beam,
    recording: Observations,
    *,
    uncertain: UncertainStiffness | None = None,
    part: FilmPart = FilmPart(),
    settings: DampingSettings = DampingSettings(),
) -> SwingFit:
    """Loss time, and k over mass, from a free swing of a learned beam. A beam without a mass gets the recording's, or
    else the mass that fits the frequency. `uncertain`: the band on k(s). Raises `LearningError` if no swing is seen, or
    no motion of this beam fits."""
    swing = find_swing(recording, part)
    weighed, known = _with_mass(beam, recording, settings)
    try:
        on = _body(weighed, settings)
        _refuse_slow(swing, float(_vibration(on, swing).frequency[0]))
        mode, modes = _first_mode(swing)
        mode = _with_later_part(swing, mode)
        factor, found = _matched(on, swing, mode.squared, mass_known=known)
        off = _off_shape(swing, modes, found)
        model_sd = _model_sd(weighed, uncertain, swing, settings)
    except MechanicsError as error:
        raise LearningError(f"{recording.source.name}: the learned beam cannot swing so ({error})") from error
    fit = _result(swing, mode, factor, found, weighed, model_sd, off[0], mass_known=known)
    return replace(fit, remarks=_notices(fit, off[1]))


def _refuse_slow(swing: Swing, expected: float) -> None:
    """Raises `LearningError` where the film has too few frames for a swing of `expected` Hz."""
    if expected > NYQUIST * swing.rate:
        raise LearningError(
            f"{swing.name}: {swing.rate:.3g} frames/s cannot show a swing of {expected:.3g} Hz. "
            f"Film at {expected / 0.2:.3g} frames/s or more"
        )


def _with_mass(beam: Beam, recording: Observations, settings: DampingSettings) -> tuple[Beam, bool]:
    """The beam with a mass, and whether it is known; 1 kg/m stands for it where it is not."""
    own = beam.mass_per_length(_GRID)
    if np.all(own > 0.0) and not isinstance(beam.mass_per_length, Uniform):
        return beam, True
    known = bool(np.all(own > 0.0) or recording.stated.mass > 0.0)  # NaN is not
    total = float(own[0]) * beam.length if np.all(own > 0.0) else recording.stated.mass if known else beam.length
    along: Profile = Uniform(total / beam.length)
    if settings.mass_along == "width":
        share = np.cbrt(np.maximum(beam.stiffness(_GRID), 0.0))
        share = share / np.trapezoid(share, _GRID)
        along = Table(tuple(_GRID.tolist()), tuple((total / beam.length * share).tolist()))
    return replace(beam, mass_per_length=along), known


def _body(beam: Beam, settings: DampingSettings) -> Body:
    smooth = not (beam.stiffness.jumps or beam.rest_curvature.jumps or beam.mass_per_length.jumps)
    return body(beam, Modes(settings.modes) if smooth else None)


def _vibration(on: Body, swing: Swing, most: int = 2) -> Vibration:
    actions = Actions(gravity=swing.gravity)
    rest = settle(on, actions, load_steps=20 if np.any(swing.gravity) else 1)
    return vibration_of(on, rest, actions, count=most)


def _model_sd(beam: Beam, uncertain: UncertainStiffness | None, swing: Swing, settings: DampingSettings) -> float:
    """Relative sd of the model's own omega^2: the band on k(s), and how a mass known only as a whole may lie."""
    if uncertain is None:
        return float("nan")
    rng, squared = np.random.default_rng(settings.seed), []
    spread = Priors().mass_spread if isinstance(beam.mass_per_length, Uniform) else 0.0
    for one in uncertain.draw(_DRAWS, seed=settings.seed):
        drawn = replace(beam, stiffness=one, mass_per_length=_uneven(beam.mass_per_length, spread, rng))
        squared.append(float(_vibration(_body(drawn, settings), swing, 1).squared[0]))
    return float(np.std(np.log(np.maximum(squared, 1e-300))))


def _uneven(mass: Profile, spread: float, rng: np.random.Generator) -> Profile:
    """A mass of the same total, with Legendre parts of sd `spread`."""
    if spread == 0.0:
        return mass
    share = 1.0 + np.polynomial.legendre.legval(2.0 * _GRID - 1.0, [0.0, *(spread * rng.standard_normal(3))])
    share = np.maximum(share, 0.05)
    return Table(tuple(_GRID.tolist()), tuple((mass(_GRID) * share / np.trapezoid(share, _GRID)).tolist()))


def _result(
    swing: Swing, mode: _Mode, factor: float, found: Vibration, beam: Beam, model_sd: float, rms: Array, *,
    mass_known: bool,
) -> SwingFit:  # fmt: skip
    bending = _of_bending(found)
    loss, sd = 2.0 * mode.decay / float(bending[0]), mode.squared_sd / float(bending[0])
    loss_sd = float(np.hypot(mode.decay_sd / max(mode.decay, 1e-300), sd))
    ratio = 0.5 * loss * bending / np.sqrt(found.squared)
    return SwingFit(
        beam=beam if mass_known else replace(beam, mass_per_length=Scaled(1.0 / factor, beam.mass_per_length)),
        damping=Damping(
            loss_time=loss,
            loss_time_sd=loss * loss_sd,
            frequency=tuple(found.frequency.tolist()),
            frequency_sd=float(0.5 * mode.squared_sd / found.squared[0] * found.frequency[0]),
            ratio=tuple(ratio.tolist()),
            ratio_sd=float(ratio[0]) * loss_sd,
            recording=swing.name,
        ),
        mass_known=mass_known,
        factor=factor if mass_known else 1.0,
        factor_sd=factor * sd if mass_known else float("nan"),
        model_sd=model_sd,
        mass=found.body.mass,
        mass_sd=float("nan") if mass_known else found.body.mass * float(np.hypot(sd, model_sd)),
        swing=swing,
        rms=rms,
        remarks=(),
    )


def _notices(fit: SwingFit, motion: Array) -> tuple[Notice, ...]:
    """`motion` (m,) m RMS of the tags over a swing."""
    out: list[Notice] = []
    share = np.nan_to_num(fit.rms / motion)
    worst = int(np.argmax(share))
    if share[worst] > _FAR_OFF:
        values = {"s": float(fit.swing.s[worst]), "rms": float(fit.rms[worst]), "motion": float(motion[worst])}
        out.append(Notice("swing missed", values))
    if fit.damping.loss_time_sd > _HARDLY * fit.damping.loss_time:
        out.append(Notice("damping unseen"))
    if fit.mass_known:
        sd = float(np.hypot(fit.factor_sd, fit.model_sd))
        away = abs(np.log(fit.factor)) / sd if np.isfinite(sd) else 0.0
        code = "swing agrees" if away <= _CONTRADICTS else "swing contradicts"
        values = {"factor": fit.factor, "sd": sd, "swing_sd": fit.factor_sd, "model_sd": fit.model_sd, "away": away}
        out.append(Notice(code if np.isfinite(sd) else "swing without a band", values))
    elif not np.isfinite(fit.mass_sd):
        out.append(Notice("mass without a band"))
    return tuple(out)
