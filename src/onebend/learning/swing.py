"""Damping, and k over mass, from a film of the beam swinging freely."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.optimize import least_squares

from onebend.beam.dynamics import Actions, Body, body
from onebend.beam.grid import Modes
from onebend.beam.integration import IntegrationSettings, Method, MotionState, simulate
from onebend.beam.model import Beam
from onebend.beam.stiffness import Profile, Scaled, Table, UncertainStiffness, Uniform
from onebend.beam.vibration import Vibration, settle, vibration_of
from onebend.errors import LearningError, MechanicsError
from onebend.learning.frames import whitening
from onebend.learning.outcome import Notice
from onebend.learning.parameters import Priors
from onebend.options import option
from onebend.progress import Progress, Silent, one_blas_thread
from onebend.recording.signals import MAD_TO_SD
from onebend.records import Array, Observations, covariance_with_camera

_MARGIN = 0.1  # s after the last contact found: the tool leaves the beam within it
_FEWEST = 12  # frames
_VISIBLE = 10.0  # sd of a tag's noise that the swing must exceed
_END = 0.25  # of a record, over which a swing is nearest to its middle
_CLEAR = 5.0  # sd of a tag's place that half a swing must exceed
_UNEVEN, _GROWS = 0.4, 1.2  # by which half swings may differ in time, and grow, as frames are few
_HALF_SWINGS = 4  # that are a swing
_NYQUIST = 0.45  # of the frame rate: faster swings cannot be told from slower ones


@dataclass(frozen=True)
class FilmPart:
    """Which frames to take, on the film's clock [s]; None: from the release found in the data, to the end."""

    begin: float | None = option(
        "--from-s", None, "The beam swings freely from here on in the film; default: found.", metavar="SECONDS"
    )
    end: float | None = option("--to-s", None, "And to here in the film; default: to the end.", metavar="SECONDS")


@dataclass(frozen=True)
class Swing:
    """Tags of T frames of free motion, m tags; what was seen of a tag is x, y [m] and its angle [rad]."""

    name: str
    time: Array  # (T,) s since the first of these frames
    begin: float  # s, the first of them on the film's clock
    s: Array  # (m,)
    seen: Array  # (T, m, 3) NaN where a tag was not seen
    whiten: Array  # (T, m, 3, 3) inverse Cholesky factors of the covariances; zero where a tag was not seen
    rest: Array  # (m, 3) the tags of the beam at rest
    gravity: Array  # (2,) m/s^2
    rate: float  # frames/s


@dataclass(frozen=True)
class Glance:
    """A damped sinusoid through one number of one tag."""

    tag: int  # index
    part: int  # 0, 1, 2: x, y, angle
    omega: float  # rad/s, of the damped swing
    decay: float  # 1/s, of its amplitude
    value: float  # m or rad from rest, at the first frame
    slope: float  # m/s or rad/s there


def find_swing(o: Observations, part: FilmPart = FilmPart()) -> Swing:
    """The free swing after the last contact, or in `part` of the film. Raises `LearningError` for too few frames, no
    rest, a base that turns, or no visible motion."""
    film_time = o.time - (o.source.clock.offset if o.source.clock is not None else 0.0)
    begin = _release(o, film_time) if part.begin is None else part.begin
    chosen = (film_time >= begin) & (film_time <= (np.inf if part.end is None else part.end))
    seen = np.concatenate([o.xy, o.angle[..., None]], axis=-1)
    there = np.isfinite(seen).all(axis=-1) & np.isfinite(covariance_with_camera(o)).all(axis=(-1, -2))
    chosen &= there.any(axis=1)
    if chosen.sum() < _FEWEST:
        raise LearningError(
            f"{o.source.name}: {int(chosen.sum())} frames show tags from {begin:.2f} s of the film on; at least "
            f"{_FEWEST} are needed. Film on after the release until the beam has almost stopped"
        )
    rest = np.concatenate([o.rest_xy, o.rest_angle[:, None]], axis=-1)
    if not np.isfinite(rest).all():
        raise LearningError(
            f"{o.source.name}: not every tag is seen at rest. Begin the film with the free beam at rest"
        )
    if np.ptp(o.gravity[chosen], axis=0).max() > 0.2:
        raise LearningError(
            f"{o.source.name}: the base turns while the beam swings. Let it swing from a base that stands"
        )
    shown = np.where(there[chosen][..., None], seen[chosen], np.nan)
    swing = Swing(
        name=o.source.name,
        time=o.time[chosen] - o.time[chosen][0],
        begin=float(film_time[chosen][0]),
        s=o.marker_s,
        seen=shown,
        whiten=whitening(shown, covariance_with_camera(o)[chosen]),
        rest=rest,
        gravity=np.asarray(o.gravity[chosen].mean(axis=0)),
        rate=1.0 / float(np.median(np.diff(o.time))),
    )
    away = np.einsum("tmij,tmj->tmi", swing.whiten, np.nan_to_num(swing.seen - rest))
    if np.abs(away).max() < _VISIBLE:
        raise LearningError(
            f"{o.source.name}: the beam hardly moves from {begin:.2f} s of the film on. Bend it further"
        )
    return swing


def shortened(swing: Swing, duration: float) -> Swing:
    """Its first part."""
    keep = swing.time <= duration
    return replace(swing, time=swing.time[keep], seen=swing.seen[keep], whiten=swing.whiten[keep])


def glance(swing: Swing, expected: float) -> Glance:
    """Frequency and decay of the best seen coordinate; `expected`: rad/s, of the model. Raises `LearningError` if the
    film is too slow or too short."""
    highest = _NYQUIST * swing.rate * 2.0 * np.pi
    if expected > highest:
        raise LearningError(
            f"{swing.name}: {swing.rate:.3g} frames/s cannot show a swing of {expected / (2 * np.pi):.3g} Hz. "
            f"Film at {expected / (2 * np.pi) / 0.2:.3g} frames/s or more"
        )
    tag, part = _clearest(swing)
    values = swing.seen[:, tag, part] - swing.rest[tag, part]
    good = np.isfinite(values)
    time, values = swing.time[good], values[good]
    if time[-1] - time[0] < np.pi / expected:
        raise LearningError(f"{swing.name}: {time[-1] - time[0]:.2g} s are less than half a swing. Film for longer")
    lowest, apart = expected / 3.0, np.pi / 4.0 / (time[-1] - time[0])
    tried = np.arange(lowest, min(3.0 * expected, highest), min(apart, 0.05 * lowest))
    pairs = [(omega, omega * share) for omega in tried for share in (0.003, 0.01, 0.03, 0.1, 0.3)]
    errors = [np.sum(_left(time, values, omega, decay)[0] ** 2) for omega, decay in pairs]
    best = least_squares(
        lambda x: _left(time, values, x[0], x[1])[0], pairs[int(np.argmin(errors))], x_scale=[expected, 0.1 * expected]
    )
    omega, decay = float(best.x[0]), max(float(best.x[1]), 1e-3 * float(best.x[0]))
    _, (a, b) = _left(time, values, omega, decay)
    return Glance(tag, part, omega, decay, float(a), float(omega * b - decay * a))


def _release(o: Observations, film_time: Array) -> float:
    """s on the film's clock from which the beam is free: after the last contact, or from the first regular passage
    through rest."""
    touched = np.flatnonzero(o.loaded)
    free = _swings_from(o, film_time)
    if np.isfinite(free) and not (len(touched) and film_time[touched[-1]] < free):
        return free
    if not len(touched):
        raise LearningError(f"{o.source.name}: no contact was found, so no release. Say when the beam swings: --from-s")
    if touched[-1] == len(o.time) - 1:
        raise LearningError(
            f"{o.source.name}: the beam is pushed to the end of the film. Film on after the release; or, where it "
            "swings freely in a part of the film, say from when on: --from-s"
        )
    return float(film_time[touched[-1]]) + _MARGIN


def _swings_from(o: Observations, film_time: Array) -> float:
    """s, of the first passage through rest of a swing that is regular and dies away; NaN where no tag shows one."""
    spread = np.sqrt(np.trace(covariance_with_camera(o)[..., :2, :2], axis1=-2, axis2=-1))
    found = []
    for i in range(len(o.tag_id)):
        seen = np.isfinite(o.xy[:, i]).all(axis=1) & np.isfinite(spread[:, i])
        if seen.sum() < _FEWEST or not np.isfinite(o.rest_xy[i]).all():
            continue
        away = o.xy[seen, i] - o.rest_xy[i]
        along = np.linalg.svd(away, full_matrices=False)[2][0]
        found.append(_first_passage(film_time[seen], away @ along, _CLEAR * float(np.median(spread[seen, i]))))
    return float(np.nanmin(found)) if np.isfinite(found).any() else float("nan")


def swinging_part(time: Array, signals: Array) -> tuple[float, float]:
    """s, from the first passage of a regular decaying swing to the end; all of it if no signal (N, C) shows one."""
    found = []
    for column in signals.T:
        seen = np.isfinite(column)
        if seen.sum() < _FEWEST:
            continue
        value = column[seen] - np.median(column[seen][-max(int(_END * seen.sum()), _FEWEST) :])
        rough = float(np.median(np.abs(np.diff(value, n=2)))) / np.sqrt(6.0)
        found.append(_first_passage(time[seen], value, _CLEAR * rough))
    begin = float(np.nanmin(found)) if np.isfinite(found).any() else float(time[0])
    return begin, float(time[-1])


def _first_passage(time: Array, value: Array, least: float) -> float:
    """s, begin of the longest chain of half swings that are alike in time, do not grow and exceed `least`; NaN if it is
    short."""
    change = np.flatnonzero(np.diff(np.sign(value)) != 0.0)
    share = value[change] / (value[change] - value[change + 1])
    passage = time[change] + share * (time[change + 1] - time[change])
    size = np.array([np.max(np.abs(part)) for part in np.split(value, change + 1)[1:-1]])
    lasts = np.diff(passage)
    best, first = 0, float("nan")
    for i in range(len(lasts)):
        usual, stop = lasts[i], i
        while stop < len(lasts) and size[stop] > least and abs(lasts[stop] / usual - 1.0) < _UNEVEN:
            if stop > i and size[stop] > _GROWS * size[stop - 1]:
                break
            stop += 1
            usual = float(np.median(lasts[i:stop]))
        if stop - i > best:
            best, first = stop - i, float(passage[i])
    return first if best >= _HALF_SWINGS else float("nan")


def _clearest(swing: Swing) -> tuple[int, int]:
    """Tag and part with the largest motion over noise, in root mean square times the root of how often it is seen."""
    own = np.nan_to_num((swing.seen - swing.rest) * np.diagonal(swing.whiten, axis1=2, axis2=3))
    first = np.sum(np.isfinite(swing.seen).all(axis=-1), axis=0)
    often = first >= 0.9 * first.max()
    power = np.where(often[:, None], np.sum(own**2, axis=0), 0.0)
    tag, part = np.unravel_index(int(np.argmax(power)), power.shape)
    return int(tag), int(part)


def _left(time: Array, values: Array, omega: float, decay: float) -> tuple[Array, Array]:
    """What a damped sinusoid about a constant leaves, and its factors of cosine and sine."""
    fall = np.exp(-np.clip(decay, -1e3, 1e3) * time / max(1.0, 0.02 * abs(decay) * time[-1]))
    rows = np.stack([fall * np.cos(omega * time), fall * np.sin(omega * time), np.ones_like(time)], axis=1)
    found = np.linalg.lstsq(rows, values, rcond=None)[0]
    return values - rows @ found, found[:2]


_STEPS = 40  # a period of the slowest mode
_METHOD = IntegrationSettings(Method(3, "radau"))  # the fastest modes are over-damped; Gauss would let them ring


@dataclass(frozen=True)
class SwingProblem:
    """What the parameters (log tau, log c, displacements, rates along the modes) are compared with."""

    body: Body
    swing: Swing
    about: Vibration
    mass_known: bool
    units: Array  # (p,) what the initial state's parameters are multiples of

    @property
    def unknown(self) -> int:
        return 2 + 2 * len(self.units)


def units_of(about: Vibration, swing: Swing, most: int) -> Array:
    """Amplitudes of the modes that move some tag as far as the swing does."""
    count = min(most, len(about.squared))
    furthest = np.nanmax(np.linalg.norm(swing.seen[..., :2] - swing.rest[:, :2], axis=-1))
    return np.asarray(furthest / np.linalg.norm(about.moved(swing.s)[:count], axis=-1).max(axis=1))


def first_guess(problem: SwingProblem, seen: Glance) -> Array:
    """Parameters from a damped sinusoid in the slowest mode."""
    about, x = problem.about, np.zeros(problem.unknown)
    squared = seen.omega**2 + seen.decay**2
    x[0], x[1] = np.log(2.0 * seen.decay / squared), np.log(squared / about.squared[0])
    if seen.part < 2:
        per_unit = about.moved(problem.swing.s[[seen.tag]])[0, 0, seen.part]
    else:
        per_unit = (about.body.to_places(problem.swing.s[[seen.tag]]) @ about.shapes)[0, 0]
    per_unit *= problem.units[0]
    count = len(problem.units)
    x[2], x[2 + count] = seen.value / per_unit, seen.slope / per_unit / np.sqrt(about.squared[0])
    return x


def predict(problem: SwingProblem, x: Array) -> Array:
    """(T, m, 3) where the tags are."""
    swing, count, factor = problem.swing, len(problem.units), float(np.exp(x[1]))
    on = scaled(problem.body, factor, float(np.exp(x[0])), mass_known=problem.mass_known)
    actions = Actions(gravity=swing.gravity)
    rest = at_rest(on, swing.gravity)
    shapes = problem.about.shapes[:, :count] * problem.units
    rates = shapes * np.sqrt(np.abs(problem.about.squared[:count]))
    start = MotionState(rest.theta + shapes @ x[2 : 2 + count], rates @ x[2 + count :])
    period = 2.0 * np.pi / np.sqrt(problem.about.squared[0] * factor)
    motion = simulate(on, start, float(swing.time[-1]), period / _STEPS, actions, settings=_METHOD)
    states = motion.states_at(np.minimum(swing.time, motion.time[-1]))
    return _riding(on, states, rest.theta, swing)


def _riding(on: Body, states: Array, at_rest: Array, swing: Swing) -> Array:
    """(T, m, 3) tags that sit on the beam as they do at rest, for states (T, n)."""
    still, tangent = at_rest[None], on.angle(swing.s, at_rest[None])[0]
    away = swing.rest[:, :2] - on.xy(swing.s, still)[0]
    turned = on.angle(swing.s, states)
    by = turned - tangent
    cos, sin = np.cos(by), np.sin(by)
    shift = np.stack([cos * away[:, 0] - sin * away[:, 1], sin * away[:, 0] + cos * away[:, 1]], axis=-1)
    return np.concatenate([on.xy(swing.s, states) + shift, (by + swing.rest[:, 2])[..., None]], axis=-1)


def scaled(on: Body, factor: float, loss_time: float, *, mass_known: bool) -> Body:
    """With k over mass times `factor`: by k where the mass is known, else by the mass; and damping tau k."""
    if mass_known:
        stiff = factor * on.stiffness
        return replace(on, stiffness=stiff, damping=loss_time * stiff)
    mass = 1.0 / factor
    return replace(
        on, carried=mass * on.carried, lever=mass * on.lever, mass=mass * on.mass, damping=loss_time * on.stiffness
    )


def at_rest(on: Body, gravity: Array) -> MotionState:
    """The body at rest under its weight."""
    return settle(on, Actions(gravity=gravity), load_steps=20 if np.any(gravity) else 1)


_ROUNDS, _ENOUGH = 25, 1e-3  # of Gauss-Newton; the step in sd at which it stops
_HUBER = 3.0  # scaled sd beyond which a residual counts linearly
_BOLD = 0.7  # the most that the logarithms of loss time and factor change in a step


@dataclass(frozen=True)
class Fitted:
    """Where the search ended."""

    x: Array
    covariance: Array
    predicted: Array  # (T, m, 3)
    moved: bool  # still, when the rounds were used up


def fit_swing(problem: SwingProblem, x: Array, progress: Progress) -> Fitted:
    """Gauss-Newton on the first three swings, then on all."""
    omega = float(np.sqrt(problem.about.squared[0] * np.exp(x[1])))
    near = shortened(problem.swing, 6.0 * np.pi / omega)
    progress.start("fitting the swing", None)
    try:
        x = _search(replace(problem, swing=near), x, progress).x
        return _search(problem, x, progress)
    finally:
        progress.done()


def _search(problem: SwingProblem, x: Array, progress: Progress) -> Fitted:
    left = _residual(problem, predict(problem, x))
    moved = True
    for _ in range(_ROUNDS):
        scale = _scale(left)
        weights = np.sqrt(np.minimum(1.0, _HUBER * scale / np.maximum(np.abs(left), 1e-300)))
        slope = _slope(problem, x, left)
        rows = np.concatenate([weights[:, None] * slope, _prior_rows(problem, scale)])
        right = np.concatenate([-weights * left, -_prior_rows(problem, scale) @ x])
        step = np.linalg.lstsq(rows, right, rcond=None)[0]
        x, left, share = _stepped(problem, x, step, left, scale)
        progress.advance()
        sd = scale * np.sqrt(np.diag(np.linalg.pinv(rows.T @ rows)))
        moved = bool(np.any(np.abs(share * step) > _ENOUGH * sd)) and share > 0.0
        if not moved:
            break
    return Fitted(x, _covariance(problem, rows, weights * left, scale), predict(problem, x), moved)


def _stepped(problem: SwingProblem, x: Array, step: Array, left: Array, scale: float) -> tuple[Array, Array, float]:
    """The new parameters and residuals, and the share of the step that was taken (0: none lowers the cost)."""
    before = _cost(left, x, scale)
    share = min(1.0, _BOLD / max(float(np.abs(step[:2]).max()), 1e-300))
    for _ in range(8):
        tried = x + share * step
        try:
            found = _residual(problem, predict(problem, tried))
        except MechanicsError:
            found = np.full_like(left, np.inf)
        if _cost(found, tried, scale) < before:
            return tried, found, share
        share *= 0.5
    return x, left, 0.0


def _cost(left: Array, x: Array, scale: float) -> float:
    size = np.abs(left) / scale
    spread = np.where(size < _HUBER, 0.5 * size**2, _HUBER * size - 0.5 * _HUBER**2)
    return float(np.sum(spread) + 0.5 * np.sum(x[2:] ** 2))


def _prior_rows(problem: SwingProblem, scale: float) -> Array:
    rows = scale * np.eye(problem.unknown)
    return rows[2:]


def _residual(problem: SwingProblem, predicted: Array) -> Array:
    """(R,) whitened, of all that was seen."""
    away = np.nan_to_num(predicted - problem.swing.seen)
    whitened = np.einsum("tmij,tmj->tmi", problem.swing.whiten, away)
    return np.asarray(whitened[np.isfinite(problem.swing.seen)])


def _slope(problem: SwingProblem, x: Array, left: Array) -> Array:
    """(R, p) by differences; the simulation's own error is far below the step's effect."""
    out = np.empty((len(left), len(x)))
    for i in range(len(x)):
        moved = x.copy()
        moved[i] += 1e-4
        out[:, i] = (_residual(problem, predict(problem, moved)) - left) / 1e-4
    return out


def _scale(left: Array) -> float:
    return max(MAD_TO_SD * float(np.median(np.abs(left))), 0.1)


def _covariance(problem: SwingProblem, rows: Array, left: Array, scale: float) -> Array:
    """(p, p): residuals summed over half swings; no smaller than what their size alone gives."""
    bread = np.linalg.pinv(rows.T @ rows)
    period = 2.0 * np.pi / np.sqrt(problem.about.squared[0])
    there = np.isfinite(problem.swing.seen)
    when = np.broadcast_to(problem.swing.time[:, None, None], there.shape)[there]
    block = (when / (0.5 * period)).astype(int)
    scores = np.zeros((block.max() + 1, rows.shape[1]))
    np.add.at(scores, block, rows[: len(left)] * left[:, None])
    count = len(np.unique(block))
    blocks = bread @ (scores.T @ scores) @ bread * count / max(count - 2, 1)
    plain = scale**2 * bread
    grown = np.maximum(np.sqrt(np.diag(blocks) / np.diag(plain)), 1.0)
    return np.asarray(grown[:, None] * plain * grown)


# The beam moves by (7) with Kelvin-Voigt damping d(s) = tau k(s). Unknown are tau, a factor c on k over mass, and the
# first state along the slowest modes. The sd come from residuals summed over half swings (White's estimate).

MassAlong = Literal["even", "width"]

_DRAWS = 60  # of k(s) and of the mass, for what they do to the frequency
_CONTRADICTS = 3.0  # sd by which c differs from 1 before it is called a contradiction
_HARDLY = 0.3  # relative sd of the loss time beyond which it is hardly known
_FAR_OFF = 0.05  # of a tag's own motion (RMS): further from the fitted one, the model is said to be wrong
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
    modes: int = 10  # curvature modes of the simulated beam
    start_modes: int = 4  # vibration modes that the first frame's state is made of
    most_periods: float = 20.0  # later frames show little but noise
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
    predicted: Array  # (T, m, 3) tags as the fitted motion moves them: x, y, angle
    rms: Array  # (m,) m, distance of the tags from it
    remarks: tuple[Notice, ...]


@one_blas_thread
def learn_damping(
    beam: Beam,
    recording: Observations,
    *,
    uncertain: UncertainStiffness | None = None,
    part: FilmPart = FilmPart(),
    settings: DampingSettings = DampingSettings(),
    progress: Progress = Silent(),
) -> SwingFit:
    """Loss time, and k over mass, from a free swing of a learned beam. A beam without a mass gets the recording's, or
    else the mass that fits the frequency. `uncertain`: the band on k(s). Raises `LearningError` if no swing is seen, or
    no motion of this beam fits."""
    swing = find_swing(recording, part)
    weighed, known = _with_mass(beam, recording, settings)
    try:
        on = _body(weighed, settings)
        about = _vibration(on, swing)
        seen = glance(swing, float(np.sqrt(about.squared[0])))
        swing = shortened(swing, settings.most_periods * 2.0 * np.pi / seen.omega)
        problem = SwingProblem(on, swing, about, known, units_of(about, swing, settings.start_modes))
        fitted = fit_swing(problem, first_guess(problem, seen), progress)
        model_sd = _model_sd(weighed, uncertain, swing, settings)
        return _result(problem, fitted, weighed, model_sd)
    except MechanicsError as error:
        raise LearningError(f"{recording.source.name}: the learned beam cannot swing so ({error})") from error


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


def _vibration(on: Body, swing: Swing, most: int = 6) -> Vibration:
    return vibration_of(on, at_rest(on, swing.gravity), Actions(gravity=swing.gravity), count=most)


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


def _result(problem: SwingProblem, fitted: Fitted, beam: Beam, model_sd: float) -> SwingFit:
    known, swing = problem.mass_known, problem.swing
    loss, factor = (float(np.exp(v)) for v in fitted.x[:2])
    sd = np.sqrt(np.diag(fitted.covariance))[:2]
    on = scaled(problem.body, factor, loss, mass_known=known)
    found = _vibration(on, swing, 2)
    frequency, of_modes = found.frequency, np.einsum("ni,nm,mi->i", found.shapes, on.damping, found.shapes)
    ratio = 0.5 * of_modes / np.sqrt(found.squared)
    away = np.linalg.norm((fitted.predicted - swing.seen)[..., :2], axis=-1)
    fit = SwingFit(
        beam=beam if known else replace(beam, mass_per_length=Scaled(1.0 / factor, beam.mass_per_length)),
        damping=Damping(
            loss_time=loss,
            loss_time_sd=loss * float(sd[0]),
            frequency=tuple(frequency.tolist()),
            frequency_sd=float(0.5 * sd[1] * frequency[0]),
            ratio=tuple(ratio.tolist()),
            ratio_sd=float(ratio[0] * np.hypot(sd[0], 0.5 * sd[1])),
            recording=swing.name,
        ),
        mass_known=known,
        factor=factor if known else 1.0,
        factor_sd=factor * float(sd[1]) if known else float("nan"),
        model_sd=model_sd,
        mass=on.mass,
        mass_sd=float("nan") if known else on.mass * float(np.hypot(sd[1], model_sd)),
        swing=swing,
        predicted=fitted.predicted,
        rms=np.sqrt(np.nanmean(away**2, axis=0)),
        remarks=(),
    )
    return replace(fit, remarks=_notices(fit, fitted))


def _notices(fit: SwingFit, fitted: Fitted) -> tuple[Notice, ...]:
    out: list[Notice] = []
    if fitted.moved:
        out.append(Notice("swing moved"))
    travel = np.sqrt(np.nanmean(np.sum((fit.swing.seen - fit.swing.rest)[..., :2] ** 2, axis=-1), axis=0))
    worst = int(np.nanargmax(fit.rms / travel))
    if fit.rms[worst] > _FAR_OFF * travel[worst]:
        values = {"s": float(fit.swing.s[worst]), "rms": float(fit.rms[worst]), "motion": float(travel[worst])}
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
