"""Which frames of a recording can be learned from, and what acts on the beam in them."""

from __future__ import annotations

import numpy as np

from onebend.beam.loads import Loads, push, weight
from onebend.beam.stiffness import Profile, Table, Uniform
from onebend.records import Array, BoolArray, Observations


def usable_frames(observations: Observations) -> BoolArray:
    """(T,) frames under load whose force is known and that show at least one tag."""
    seen = np.any(np.isfinite(observations.xy), axis=(1, 2))
    forced = np.all(np.isfinite(observations.force), axis=1) & np.isfinite(push_places(observations))
    weighed = np.any(observations.gravity != 0.0, axis=1)
    return np.asarray(seen & forced & (observations.loaded | weighed))


def push_places(observations: Observations) -> Array:
    """(T,) where the force acts; the tip in frames without any force, where the place does not matter."""
    forceless = np.all(observations.force == 0.0, axis=1)
    return np.where(forceless & np.isnan(observations.push_s), 1.0, observations.push_s)


def loads_of(observations: Observations, frames: BoolArray) -> Loads:
    """The measured loads in those frames, weight included."""
    gravity = observations.gravity[frames]
    loads = push(observations.force[frames], push_places(observations)[frames]) + known_loads(observations, frames)
    return loads + weight(gravity) if np.any(gravity != 0.0) else loads


def known_loads(observations: Observations, frames: BoolArray) -> Loads:
    """What acts in those frames besides the logged force and the weight."""
    known = observations.known
    if known is None:
        return Loads()
    return Loads(known.force[frames], known.force_s[frames], known.moment[frames], known.moment_s[frames])


def mass_profile(observations: Observations) -> Profile:
    """kg/m along the beam, as written down; zero where no mass is known."""
    line, mass = observations.mass_line, observations.mass
    if line is not None:
        return Table(tuple(line.s.tolist()), tuple(line.value.tolist()))
    return Uniform(mass / observations.length if np.isfinite(mass) else 0.0)


def whitening(measured: Array, covariance: Array) -> Array:
    """(..., 3, 3) inverse Cholesky factors of the covariances (..., 3, 3) of poses; zero where a number is missing.

    A pose may lack its angle, or one coordinate: the rest of it counts by its own part of the covariance.
    """
    whole = np.all(np.isfinite(covariance), axis=(-1, -2))
    there = np.isfinite(measured) & whole[..., None]
    both = there[..., :, None] & there[..., None, :]
    factors = np.linalg.inv(np.linalg.cholesky(np.where(both, covariance, np.eye(3))))
    return np.asarray(np.where(both, factors, 0.0))


def distances(difference: Array) -> Array:
    """(...) m, lengths of differences (..., 2) over the coordinates that are there; NaN where none is."""
    there = np.isfinite(difference)
    length = np.sqrt(np.sum(np.where(there, difference, 0.0) ** 2, axis=-1))
    return np.asarray(np.where(np.any(there, axis=-1), length, np.nan))
