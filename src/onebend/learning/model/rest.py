"""The beam at rest: its natural curvature, and how each tag sits on it.

Before contact every tag should lie on the straight beam at its own s. What is seen there instead is the beam's natural
curvature plus the tags' mounting errors; the two are told apart by how likely each is. A mounting error is rigid: it
turns with the beam, so it is taken off every frame in the tag's own frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.modal import Modes, angles, jacobians, places, positions
from onebend.learning.model.parameters import Priors, curvature_sd
from onebend.recording.tracks.chords import chord_angles
from onebend.records import Array, BoolArray, Observations

_REST_MODES = Modes(3)
_EXACT = 1e-6  # m, rad: what is taken for it where a tag is said to sit exactly


@dataclass(frozen=True)
class AtRest:
    """The unloaded beam."""

    theta0: Array  # (3,) rad, Legendre states of q0; zeros for a straight beam
    offset: Array  # (m, 2) m, of each tag from its place on the beam, in the beam's tangent frame there
    turn: Array  # (m,) rad, of each tag against the tangent
    seen: bool  # False where no rest frames exist: then all are zero

    def states(self, n: int) -> Array:
        """(n,) rest states for n Legendre modes (cut or filled with zeros)."""
        out = np.zeros(n)
        count = min(n, len(self.theta0))
        out[:count] = self.theta0[:count]
        return out


def at_rest(observations: Observations, priors: Priors = Priors()) -> AtRest:
    """Natural curvature and mounting from the frames before contact (maximum a posteriori, Gauss-Newton)."""
    m = len(observations.marker_s)
    known: BoolArray = np.asarray(np.isfinite(observations.rest_xy).all(axis=1))
    if not np.any(known):
        return AtRest(np.zeros(_REST_MODES.n), np.zeros((m, 2)), np.zeros(m), seen=False)
    theta = np.zeros(_REST_MODES.n)
    bent_sd = curvature_sd(observations, priors)
    if bent_sd > 0.0:
        theta = _rest_states(observations, known, bent_sd)
    at = places(observations.length, _REST_MODES, observations.marker_s)
    alpha = angles(at, theta[None])[0]
    away = observations.rest_xy - positions(at, theta[None])[0]
    cos, sin = np.cos(alpha), np.sin(alpha)
    offset = np.stack([cos * away[:, 0] + sin * away[:, 1], -sin * away[:, 0] + cos * away[:, 1]], axis=1)
    turn = np.nan_to_num(observations.rest_angle - alpha)  # a marker without an angle has no turn
    return AtRest(theta, np.where(known[:, None], offset, 0.0), np.where(known, turn, 0.0), seen=True)


def beam_points(observations: Observations, rest: AtRest) -> tuple[Array, Array]:
    """Points (T, m, 2) and tangent angles (T, m) of the beam under each tag: mounting errors taken off.

    The offset of a marker without an angle is turned by the angle of the chords beside it.
    """
    tangent = observations.angle - rest.turn
    turned = np.where(np.isfinite(tangent), tangent, chord_angles(observations.xy, observations.marker_s))
    turned = np.where(np.isfinite(turned), turned, 0.0)
    cos, sin = np.cos(turned), np.sin(turned)
    dx, dy = rest.offset[:, 0], rest.offset[:, 1]
    shift = np.stack([cos * dx - sin * dy, sin * dx + cos * dy], axis=-1)
    return observations.xy - shift, tangent


def _rest_states(observations: Observations, known: BoolArray, bent_sd: float) -> Array:
    """States that balance curvature (one sd `bent_sd`, rad) against mounting, each measured by its own sd."""
    at = places(observations.length, _REST_MODES, observations.marker_s[known])
    of_tags = np.repeat([observations.stated.placement_sd, observations.stated.turn_sd], [2 * len(at.s), len(at.s)])
    sd = np.maximum(of_tags, _EXACT)
    theta = np.zeros(_REST_MODES.n)
    for _ in range(5):
        jacobian = np.concatenate([jacobians(at, theta[None])[0].reshape(-1, _REST_MODES.n), at.to_places])
        away = np.concatenate(
            [
                (observations.rest_xy[known] - positions(at, theta[None])[0]).ravel(),
                np.nan_to_num(observations.rest_angle[known] - angles(at, theta[None])[0]),
            ]
        )
        jacobian[2 * len(at.s) :] *= np.isfinite(observations.rest_angle[known])[:, None]
        rows = np.concatenate([jacobian / sd[:, None], np.eye(_REST_MODES.n) / bent_sd])
        right = np.concatenate([away / sd, -theta / bent_sd])
        theta = theta + np.linalg.lstsq(rows, right, rcond=None)[0]
    return theta
