"""What is known of the beam's mass, and a first guess where nothing is: stiffness and mass are then learned together.

Weight bends the beam by mu / k, so from weight alone only their ratio can be had. A force of known size, logged or
hung on, fixes both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from onebend.errors import LearningError
from onebend.records import MassAlong, Observations, Remark

FREE = 2.0  # one sd of an unknown mass, over its first guess: next to no knowledge
TOLD = 0.7  # of the prior's sd: a weighed mass that stays less sure than this was hardly learned
KNOWN = 0.35  # of itself: an unknown mass that stays less sure than this was not learned
NEEDS_MASS = "gravity acts in the plane (or it swings), so the beam's mass must be given: mass_kg in [beam]"
_SPREAD = {  # what is stated of it
    "even": "evenly spread",
    "width": "per metre taken as the third root of k(s), as where only the width varies",
    "thickness": "per metre taken as k(s), as where only the thickness varies",
    "both": "per metre taken as the root of k(s), as where width and thickness vary together",
    "section": "per metre taken as the section's area",
    "table": "spread as in mass_file",
}


@dataclass(frozen=True)
class LearnedMass:
    """The beam's mass after the fit."""

    value: float  # kg
    sd: float  # kg
    even: float  # kg, of an evenly heavy beam whose weight has the same moment about the clamp: what the data see
    even_sd: float  # kg
    written: float  # kg, as recording.toml says; NaN where it does not
    identified: bool  # the data said more of it than was known
    along: MassAlong = "unknown"  # how it is spread, as stated


def mass_remarks(mass: LearnedMass | None) -> tuple[Remark, ...]:
    """What the fit says of the mass."""
    if mass is None:
        return ()
    size = f"{1000 * mass.value:.4g} g, give or take {1000 * mass.sd:.2g} g (sd)"
    if mass.along != "unknown":
        return (_stated(mass, size),)
    even = f"it pulls on the clamp like {1000 * mass.even:.4g} g (sd {1000 * mass.even_sd:.2g} g) evenly spread"
    if not np.isfinite(mass.written):
        if mass.identified:
            return (Remark("note", f"the mass was not written down; learned with k(s): {size}; {even}"),)
        text = f"mass not identifiable: only k/mu (it came out as {size}). Weigh the beam, or load it more strongly"
        return (Remark("warning", text, about="mass unknown"),)
    if mass.identified:
        return (Remark("note", f"mass {1000 * mass.written:.4g} g as written; the data make it {size}; {even}"),)
    text = f"mass {1000 * mass.written:.4g} g as written; the data say no more of it: beside it, only k/mu"
    return (Remark("note", text),)


def _stated(mass: LearnedMass, size: str) -> Remark:
    """Where recording.toml says how it is spread, so that one number was learned."""
    spread = f'mass {_SPREAD[mass.along]}, as mass_along = "{mass.along}" says'
    if np.isfinite(mass.written):
        told = f"the data make it {size}" if mass.identified else "the data say no more of it: beside it, only k/mu"
        return Remark("note", f"{spread}; {1000 * mass.written:.4g} g as written, {told}")
    if mass.identified:
        return Remark("note", f"{spread}; not written down, and learned with k(s): {size}")
    text = f"mass not identifiable: only k/mu (it came out as {size}). Weigh the beam, or load it more strongly"
    return Remark("warning", f"{text}. {spread.capitalize()}", about="mass unknown")


def weighs(observations: Observations) -> bool:
    """Whether the beam's own weight bends it in the plane."""
    return bool(np.any(observations.gravity != 0.0))


def needs_mass(observations: Observations) -> bool:
    """Whether its mass counts: it weighs, or was seen to swing."""
    return weighs(observations) or bool(observations.frequencies)


def _alike(recordings: Sequence[Observations]) -> Sequence[Observations]:
    """What one recording says of how the mass is spread holds for all."""
    said = sorted({o.stated.mass_along for o in recordings} - {"unknown"})
    if len(said) > 1:
        names = ", ".join(o.source.name for o in recordings)
        raise LearningError(f"{names}: mass_along is {' and '.join(said)}. It is one beam: write the same in each")
    return [replace(o, stated=replace(o.stated, mass_along=said[0])) for o in recordings] if said else recordings


def mass_is_open(recordings: Sequence[Observations]) -> bool:
    """Whether the mass counts and no recording of the beam says it."""
    return any(needs_mass(o) for o in recordings) and not any(np.isfinite(o.stated.mass) for o in recordings)


def check_mass_can_be_learned(recordings: Sequence[Observations]) -> None:
    """Raises `LearningError` where an unknown weight is all that bends the beam, or it only swings, with nothing of
    known mass on it."""
    if not mass_is_open(recordings) or any(forced(o) or _carries(o) for o in recordings):
        return
    names = ", ".join(o.source.name for o in recordings)
    if not any(weighs(o) for o in recordings):
        raise LearningError(
            f"{names}: there is nothing but frequencies, and the mass is not written down. They hold only the ratio "
            "k/mu of stiffness to mass per metre. Give mass_kg in [beam], or measure them once more with a known "
            "tip_mass_kg, or add poses under a known weight"
        )
    raise LearningError(
        f"{names}: the beam's own weight is all that bends it, and its mass is not written down. Such data hold only "
        "the ratio k/mu of stiffness to mass per metre. Give mass_kg in [beam], or learn together with a push or a "
        "hung weight of known size"
    )


def _carries(observations: Observations) -> bool:
    """Whether it was seen to swing with a known mass at its tip."""
    return any(one.tip_mass > 0.0 for one in observations.frequencies)


def forced(observations: Observations) -> bool:
    """Whether something other than the beam's own weight acts on it."""
    hung = observations.known_loads is not None or (weighs(observations) and bool(observations.stated.masses))
    return bool(np.nanmax(np.abs(observations.force), initial=0.0) > 0.0) or hung


def shared_mass(recordings: Sequence[Observations], guess: float = np.nan) -> tuple[Observations, ...]:
    """The recordings, those without a mass with that of the others; where none says it, with a `guess` [kg]."""
    recordings = _alike(recordings)
    known = [o for o in recordings if np.isfinite(o.stated.mass)]
    if known:
        first = known[0]
        given = [
            o
            if np.isfinite(o.stated.mass)
            else replace(o, stated=replace(o.stated, mass=first.stated.mass, mass_line=first.stated.mass_line))
            for o in recordings
        ]
        return tuple(given)
    if not mass_is_open(recordings) or not np.isfinite(guess):
        return tuple(recordings)
    return tuple(replace(o, stated=replace(o.stated, mass=guess, mass_sd=FREE)) for o in recordings)
