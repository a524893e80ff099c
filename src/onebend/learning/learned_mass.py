"""The mass of the fitted beam: what was written down, and what the fit changed of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onebend.beam.modal import Modes
from onebend.beam.profiles.stiffness import Powers, Profile, Scaled, Table, Uniform
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.learning.inference.joint_covariance import JointCovariance
from onebend.learning.model.fit_data import FitData
from onebend.learning.model.frames import mass_profile
from onebend.learning.model.mass import KNOWN, TOLD, LearnedMass
from onebend.learning.model.own_weight import following
from onebend.learning.model.parameters import Block, Layout
from onebend.records import Array, Observations, PointMass

# Of the pull of an even beam of the written mass on its clamp: a cone on its base has 0.5, a mass at the tip 2.
LEAST_PULL, MOST_PULL = 0.42, 2.2
LEANS = 4.0  # sds of gravity's written direction, beyond which it is another one


def weight_doubts(mass: LearnedMass | None, leaning: Sequence[float]) -> tuple[str, ...]:
    """What contradicts the weight as written, given the mass after the fit and `leans`; empty as a rule."""
    doubts = []
    if mass is not None and np.isfinite(mass.written) and not LEAST_PULL < mass.even / mass.written < MOST_PULL:
        doubts.append("the beam's weight and the force contradict each other")
    if max((abs(lean) for lean in leaning), default=0.0) > LEANS:
        doubts.append("gravity does not pull where [gravity] says")
    return tuple(doubts)


def leans(recordings: Sequence[FitData], layout: Layout, mean: Array) -> list[float]:
    """How far off its written direction gravity came out in each recording in which it bends the beam, in sds."""
    found = []
    for recording in recordings:
        block = layout.index.get(("gravity direction", recording.number))
        if block is not None and block.start >= 0:
            found.append(float(mean[block.where][0] / block.prior_sd[0]))
    return found


def learned_mass(
    recordings: Sequence[FitData],
    layout: Layout,
    mean: Array,
    covariance: JointCovariance,
    stiffness: UncertainStiffness,
    gain_sd: float,
) -> LearnedMass | None:
    """The mass after the fit, from mean (P,) and covariance of its parameters; None where nothing weighs or the
    mass was held as written."""
    block, weighed = layout.index["mass", -1], _weighed(recordings)
    if block.start < 0 or weighed is None:
        return None
    change, spread = mean[block.where], covariance.among(block.where)
    written = np.nan if np.isfinite(weighed.stated.mass_sd) else weighed.stated.mass
    lever = np.array([1.0, 1.0 / 3.0, 0.0, 0.0])  # 2 int s P_i(2 s - 1) ds
    value, s = weighed.stated.mass * (1.0 + float(change[0])), np.linspace(0.0, 1.0, 2001)
    line = mass_per_length(recordings, layout, mean, stiffness)
    pull = 2.0 * weighed.length * float(np.trapezoid(s * line(s), s))
    if weighed.stated.mass_along != "unknown":
        lever = np.array([pull / value, 0.0, 0.0, 0.0])
    gain = gain_sd if np.isnan(written) else 0.0  # an unknown mass is weighed against the force
    sd = np.sqrt(np.diag(spread)[0] + gain**2)
    even_sd = float(np.sqrt(lever @ spread @ lever + (lever[0] * gain) ** 2))
    return LearnedMass(
        value=value,
        sd=float(weighed.stated.mass * sd),
        even=pull,
        even_sd=weighed.stated.mass * even_sd,
        written=written,
        identified=even_sd < _largest_sd(written, block),
        along=weighed.stated.mass_along,
    )


def mass_per_length(
    recordings: Sequence[FitData], layout: Layout, mean: Array, stiffness: UncertainStiffness
) -> Profile:
    """kg/m, at parameters (P,)."""
    weighed, change = _weighed(recordings), layout.get(mean, "mass")
    if weighed is None:
        return Uniform(0.0)
    along = following(weighed, stiffness, weighed.stated.mass * (1.0 + float(change[0])))
    if along is not None:
        return along
    even = weighed.stated.mass / weighed.length
    if weighed.stated.mass_along in ("section", "table"):
        return Scaled(1.0 + float(change[0]), mass_profile(weighed))
    if weighed.stated.mass_line is None:
        return from_legendre(even * (np.array([1.0, 0.0, 0.0, 0.0]) + change))
    s = np.unique(np.concatenate([np.linspace(0.0, 1.0, 101), weighed.stated.mass_line.s]))
    value = mass_profile(weighed)(s) + even * Modes(len(change)).curvature(s) @ change
    return Table(tuple(s.tolist()), tuple(value.tolist()))


def riding_masses(recordings: Sequence[FitData]) -> tuple[PointMass, ...]:
    """What rides on the beam in every recording of it."""
    first, *others = (recording.observations.stated.masses for recording in recordings)
    return tuple(one for one in first if all(one in masses for masses in others))


def from_legendre(states: Array) -> Profile:
    """The profile with these Legendre coefficients."""
    if np.all(states[1:] == 0.0):
        return Uniform(float(states[0]))
    return Powers(tuple(np.linalg.solve(Modes(len(states), "powers").to_legendre, states).tolist()))


def _weighed(recordings: Sequence[FitData]) -> Observations | None:
    """The recording whose mass the fit changes."""
    return next((r.observations for r in recordings if np.isfinite(r.observations.stated.mass)), None)


def _largest_sd(written: float, block: Block) -> float:
    """One sd over the mass itself, below which the mass counts as learned."""
    if np.isnan(written):
        return KNOWN
    return TOLD * float(np.hypot(block.prior_sd[0], block.prior_sd[1] / 3.0))
