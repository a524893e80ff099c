"""What all frames of a recording share when the force is told from the shape, as it is known before they are seen."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.learning.allowances.picture import camera, heights
from onebend.learning.design.instruments import Instruments
from onebend.learning.model.fit_data import REST_MODES
from onebend.learning.model.parameters import Priors, clamp_sd, curvature_sd, scale_sd
from onebend.records import Array, Observations

LEARNED = ("curvature", "along", "across", "turn")  # what the beam's recordings have in common, beside k(s)
_PLACES = 401
_REMEMBERED = 50  # grids
_SLIGHT = 3e-3  # of log k
_SAME_PLACE = 1e-6  # s


@dataclass(frozen=True)
class SharedPrior:
    """A normal density, of covariance `root root^T`, of what the frames share, part after part.

    In order: the independent ways (p) in which log k is off, its common scale, the clamp's angle, the rest curvature
    (3) besides that of the beam, the tags' places along and across and their turns (m each), the origin (2), the
    picture's scale, the discrepancy: of the places (2 m) and the angles (m) of the tags for each metre that they move;
    the unknowns of the picture, and the place of the contact where it is said.
    """

    ways: Array  # (c, p) of the c coefficients of log k, each way of variance 1
    picture: Array  # (T + 1, m, 3, v) m, m, rad: what the v unknowns of the picture do in each frame; the last at rest
    mean: Array  # (n,)
    root: Array  # (n, r)
    parts: dict[str, slice]
    memory: dict[bytes, Array] = field(default_factory=dict, compare=False)  # the ways of log k on nodes met before

    def on_nodes(self, stiffness: UncertainStiffness, nodes: Array) -> Array:
        """(..., p) of log k at `nodes` (...), per unit of each way."""
        key = nodes.tobytes()
        if key not in self.memory:
            if len(self.memory) > _REMEMBERED:
                self.memory.clear()
            self.memory[key] = (stiffness.basis(nodes.ravel()) @ self.ways).reshape(*nodes.shape, -1)
        return self.memory[key]


def shared_prior(
    observations: Observations,
    stiffness: UncertainStiffness | None,
    instruments: Instruments | None,
    *,
    tags_as_learned: bool,
    place_sd: float | tuple[float, ...],
) -> SharedPrior:
    """As the recording states it, with the discrepancy of `instruments`, and the place of the contact, or of each, to
    `place_sd` [m]; with `tags_as_learned`, rest curvature and tags are those that were learned, with what their errors
    have in common with those of k(s)."""
    o, priors = observations, Priors()
    m, stated = len(o.marker_s), o.stated
    ways = np.zeros((0, 0)) if stiffness is None else ways_of(stiffness)
    picture, picture_sd = picture_of(o)
    place, angle = (0.0, 0.0) if instruments is None else instruments.discrepancy
    sds = {
        "log k": np.ones(ways.shape[1]),
        "gain": np.full(1, 0.0 if stiffness is None else stiffness.gain_sd),
        "clamp": np.full(1, clamp_sd(o, priors)),
        "curvature": np.full(REST_MODES.n, curvature_sd(o, priors)),
        "along": np.full(m, stated.placement_sd),
        "across": np.full(m, stated.placement_sd),
        "turn": np.full(m, stated.turn_sd),
        "origin": np.full(2, stated.placement_sd),
        "scale": np.full(1, scale_sd(o, priors)),
        "discrepancy": np.concatenate([np.full(2 * m, place), np.full(m, angle)]),
        "picture": picture_sd,
        "place": np.atleast_1d(np.asarray(place_sd, dtype=float)),
    }
    ends = np.cumsum([0, *(len(sd) for sd in sds.values())]).tolist()
    parts = {name: slice(a, b) for name, a, b in zip(sds, ends[:-1], ends[1:], strict=True)}
    prior = SharedPrior(ways, picture, np.zeros(ends[-1]), np.diag(np.concatenate(list(sds.values()))), parts)
    if stiffness is None or instruments is None or not (tags_as_learned and same_tags(o, instruments)):
        return prior
    return _as_learned(prior, stiffness, instruments)


def same_tags(observations: Observations, instruments: Instruments | None) -> bool:
    """Whether what was learned of the tags is known, and tags of this recording are at the same places."""
    known = instruments is not None and instruments.shared_mean is not None
    if not known or instruments is None or len(instruments.tags) != len(observations.marker_s):
        return False
    return bool(np.allclose(instruments.tags, observations.marker_s, rtol=0.0, atol=_SAME_PLACE))


def picture_of(observations: Observations) -> tuple[Array, Array]:
    """(T + 1, m, 3, v) what the unknowns of the camera, its plane and the tags' heights over it do to the poses, those
    at rest last, and (v,) one sd of each."""
    o, count = observations, len(observations.time) + 1
    seen = np.concatenate([o.xy, o.angle[..., None]], axis=-1)
    rest = np.concatenate([o.rest_xy, o.rest_angle[:, None]], axis=-1)
    found = [] if o.by_camera is None else [camera(o, np.ones(count - 1, dtype=bool), count)]
    found += [] if o.source.view is None else [heights(o, np.concatenate([seen, rest[None]]))]
    none = np.zeros((count, *seen.shape[1:], 0))
    return np.concatenate([none, *(a.basis for a in found)], axis=-1), np.concatenate(
        [np.zeros(0), *(a.prior_sd for a in found)]
    )


def ways_of(stiffness: UncertainStiffness) -> Array:
    """(c, p) of the coefficients: the independent ways in which log k is off, each of variance 1, without those that
    change log k by less than `_SLIGHT`, root mean square over the beam."""
    values, vectors = np.linalg.eigh(stiffness.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    on_beam = stiffness.basis(np.linspace(0.0, 1.0, _PLACES)) @ root / np.sqrt(_PLACES)
    _, size, turn = np.linalg.svd(on_beam, full_matrices=False)
    return np.asarray(root @ turn[size > _SLIGHT].T)


def _as_learned(prior: SharedPrior, stiffness: UncertainStiffness, instruments: Instruments) -> SharedPrior:
    """With the joint density of log k and the rest that the learning left; ways of log k that were left out are
    counted with what k(s) does not tell."""
    ours, theirs = [], []
    for name, where in instruments.shared_parts.items():
        if name in LEARNED:
            ours += list(range(prior.parts[name].start, prior.parts[name].stop))
            theirs += list(range(where.start, where.stop))
    slope = instruments.shared_slope[theirs]
    unseen = slope @ (stiffness.covariance - prior.ways @ prior.ways.T) @ slope.T
    left = instruments.shared_covariance[np.ix_(theirs, theirs)] + unseen
    values, vectors = np.linalg.eigh(0.5 * (left + left.T))
    mean, root = prior.mean.copy(), prior.root.copy()
    root[ours] = 0.0
    root[np.ix_(ours, ours)] = vectors * np.sqrt(np.maximum(values, 0.0))
    root[ours, prior.parts["log k"]] = slope @ prior.ways
    assert instruments.shared_mean is not None
    mean[ours] = instruments.shared_mean[theirs]
    mean[prior.parts["curvature"]] = 0.0  # that of the beam is the learned one
    return SharedPrior(prior.ways, prior.picture, mean, root, prior.parts)
