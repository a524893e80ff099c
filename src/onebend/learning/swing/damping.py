"""Damping from a free swing, and k over mass beside it: least squares in marker space against the simulated motion.

The learned beam moves by (7) with Kelvin-Voigt damping d(s) = tau k(s). Unknown are the loss time tau, one factor c on
k over mass (it sets the frequency), and the state at the first frame used: displacements and rates along the slowest
vibration modes. Nothing is asked of the release: the swing is taken from after it.

The sd come from sums over half swings of what the fit leaves (White's estimate with blocks), and are never below what
the residuals' size alone would give: what is left is mostly the model's error, which is alike from frame to frame.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from onebend.beam.modal import Modes
from onebend.beam.model import Beam
from onebend.beam.motion.actions import Actions
from onebend.beam.motion.dynamics import Body, body
from onebend.beam.motion.vibration import Vibration, vibration_of
from onebend.beam.profiles.stiffness import Profile, Scaled, Table, Uniform
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.blas import one_blas_thread
from onebend.errors import LearningError, MechanicsError
from onebend.learning.model.parameters import Priors
from onebend.learning.swing.free_swing import FilmPart, Swing, find_swing, glance, shortened
from onebend.learning.swing.swing_fit import Fitted, fit_swing
from onebend.learning.swing.swing_motion import SwingProblem, at_rest, first_guess, scaled, units_of
from onebend.progress import Progress, Silent
from onebend.records import Array, Observations, Remark

MassAlong = Literal["even", "width"]

_DRAWS = 60  # of k(s) and of the mass, for what they do to the frequency
_CONTRADICTS = 3.0  # sd by which c differs from 1 before it is called a contradiction
_HARDLY = 0.3  # relative sd of the loss time beyond which it is hardly known
_FAR_OFF = 0.05  # of a tag's own motion (RMS): further from the fitted one, the model is said to be wrong
_GRID = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True)
class DampingSettings:
    """How the swing is fitted."""

    mass_along: MassAlong = "even"  # how a mass known as a whole lies along the beam; "width": as the root 3 of k
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
        """Inverse of `as_dict`.

        Raises:
            LearningError: an entry is missing, unknown, not a number, or without meaning.
        """
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
    remarks: tuple[Remark, ...]


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
    """Loss time, and k over mass, from the free swing in a recording of a learned beam.

    A beam without a mass gets the recording's; where neither is known, the mass that makes the frequency right is
    found. `uncertain`: the band on k(s), for how sure the model's own frequency is.

    Raises:
        LearningError: no free swing is seen, or no motion of this beam follows it.
    """
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
    """In modes where everything is smooth, else node by node."""
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
    """Numbers of the fit, and what is to be said of them."""
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
    return replace(fit, remarks=_remarks(fit, fitted))


def _remarks(fit: SwingFit, fitted: Fitted) -> tuple[Remark, ...]:
    out: list[Remark] = []
    if fitted.moved:
        text = "The fit still moved when its rounds were used up: its numbers are provisional. Film for longer."
        out.append(Remark("warning", text, about="swing"))
    travel = np.sqrt(np.nanmean(np.sum((fit.swing.seen - fit.swing.rest)[..., :2] ** 2, axis=-1), axis=0))
    worst = int(np.nanargmax(fit.rms / travel))
    if fit.rms[worst] > _FAR_OFF * travel[worst]:
        text = (
            f"The tag at s = {fit.swing.s[worst]:.3g} is {1000 * fit.rms[worst]:.2g} mm (RMS) from the fitted motion, "
            f"and {1000 * travel[worst]:.2g} mm from rest: the beam does not swing as the model says (another k(s) or "
            "mass along it), or is touched while it swings. Learn k(s) again, and film a release that nothing touches."
        )
        out.append(Remark("warning", text, about="swing"))
    if fit.damping.loss_time_sd > _HARDLY * fit.damping.loss_time:
        text = "The damping is hardly seen: film the swing for longer, or from further out."
        out.append(Remark("warning", text, about="swing"))
    if fit.mass_known:
        out.append(_check_of_stiffness(fit))
    if not fit.mass_known and not np.isfinite(fit.mass_sd):
        out.append(Remark("note", "The model has no band on k(s), so nothing says how sure the mass is."))
    return tuple(out)


def _check_of_stiffness(fit: SwingFit) -> Remark:
    """k over mass against the model's."""
    sd = float(np.hypot(fit.factor_sd, fit.model_sd))
    said = f"k over mass is {fit.factor:.3f} times the model's"
    if not np.isfinite(sd):
        return Remark("note", f"The swing says that {said}; the model has no band that would say if this is much.")
    said += f" (sd {sd:.2g}: {fit.factor_sd:.2g} from the swing, {fit.model_sd:.2g} from k(s) and how the mass lies)"
    away = abs(np.log(fit.factor)) / sd
    if away > _CONTRADICTS:
        text = f"The swing contradicts the model: {said}. Weigh the beam, and check the force's gain."
        return Remark("warning", text, about="swing")
    return Remark("note", f"The swing agrees with the model to {away:.1f} sd: {said}.")
