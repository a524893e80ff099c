"""What a camera shows of tags that are not where its model takes them to be: heights, tilt, lens, rolling shutter.

The camera's model puts every tag in one plane. A tag at height z over that plane is seen where its ray meets the plane:
`z / D` times its distance from the camera's foot too far out, D being the camera's own height. So is every point where
the plane is tilted by more than was found: its height then grows with its place. The frame is fixed to the base tag and
to the tags at rest, so that a tilt and a lens count by what they do to the tags beyond that.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from onebend.learning.allowances.allowance import Allowance
from onebend.learning.allowances.course import with_rest
from onebend.records import Array, BoolArray, Observations, View

HEIGHT_SD = 2e-3  # m, of each tag over the plane of all
TILT_SD = {True: 0.01, False: 0.03}  # rad, of the plane against the camera, calibrated or not
LENS_SD = {True: 0.005, False: 0.05}  # of the first radial term, calibrated or not
READOUT_SD = 0.015  # s, from the picture's first row to its last
_STEP = 1e-4  # m, to either side of a place, for the slope of a field
_Field = Callable[[Array], Array]  # (..., 2) m per unit: how far points (..., 2) m of the plane seem to be off


def camera_place(view: View) -> tuple[Array, float]:
    """(2,) m foot of the camera in the plane of the tags, and its distance from the plane [m]."""
    place = -view.rotation.T @ view.translation
    return np.asarray(place[:2]), float(abs(place[2]))


def heights(observations: Observations, measured: Array) -> Allowance:
    """Each tag's own height [m]; `measured` (F, m, 3) poses of the tags."""
    view = _view(observations)
    foot, distance = camera_place(view)
    away = np.nan_to_num(measured[..., :2] - foot) / distance
    tags = measured.shape[1]
    basis = np.zeros((*measured.shape, tags))
    for i in range(tags):
        basis[:, i, :2, i] = away[:, i]
    labels = tuple(f"height of tag {i}" for i in observations.tag_id)
    return Allowance("heights", "poses", "m", labels, np.full(tags, HEIGHT_SD), basis, shared=True)


def tilt(observations: Observations, measured: Array) -> Allowance:
    """The plane tilted along x and along y [rad] by what the tags did not show; `measured` (F, m, 3)."""
    view = _view(observations)
    foot, distance = camera_place(view)

    def field(axis: int) -> _Field:
        return lambda p: (p - foot) * p[..., axis : axis + 1] / distance

    fields = [_seen_in_frame(field(axis), measured, observations) for axis in range(2)]
    sd = np.full(2, TILT_SD[view.calibrated])
    return Allowance("tilt", "poses", "rad", ("tilt along x", "tilt along y"), sd, np.stack(fields, axis=-1))


def lens(observations: Observations, measured: Array) -> Allowance:
    """The first radial term of the lens, k1 of `n (1 + k1 |n|^2)`, over what its model says; `measured` (F, m, 3)."""
    view = _view(observations)
    turn, away = view.rotation[:, :2], view.translation

    def field(p: Array) -> Array:
        x = p @ turn.T + away
        n = x[..., :2] / x[..., 2:]
        by_place = (turn[:2] - n[..., None] * turn[2]) / x[..., 2, None, None]  # of n
        shift = n * np.sum(n**2, axis=-1, keepdims=True)
        return np.asarray(np.linalg.solve(by_place, shift[..., None])[..., 0])

    basis = _seen_in_frame(field, measured, observations)[..., None]
    return Allowance("lens", "poses", "1", ("radial lens term",), np.array([LENS_SD[view.calibrated]]), basis)


def rolling_shutter(observations: Observations, frames: BoolArray, count: int) -> Allowance:
    """The time [s] from the first row of a picture to its last: a tag in another row than the middle one is seen at
    another instant, and so is each of its corners, which turns a tag that moves: the rigid square that is nearest to
    them by half the curl. The principal point is taken to be in the middle; `count` frames, those at rest last."""
    o = observations
    pose = np.concatenate([o.xy, o.angle[..., None]], axis=-1)
    speed = np.nan_to_num(np.gradient(pose, o.time, axis=0)) if len(o.time) > 1 else np.zeros_like(pose)
    xy, late = np.nan_to_num(o.xy), _row(_view(o))
    shift = speed * late(xy)[..., None]
    by_x, by_y = (late(xy + step) - late(xy - step) for step in _STEP * np.eye(2))
    shift[..., 2] += (speed[..., 1] * by_x - speed[..., 0] * by_y) / (4.0 * _STEP)
    basis = with_rest(shift[frames][..., None], count)
    return Allowance("rolling shutter", "poses", "s", ("read-out time",), np.array([READOUT_SD]), basis)


def _row(view: View) -> Callable[[Array], Array]:
    """Of points (..., 2) m in the plane: the row (...) where they are seen, from the middle one, of all rows."""

    def row(p: Array) -> Array:
        seen = p @ view.rotation[:, :2].T + view.translation
        return np.asarray(view.matrix[1, 1] * seen[..., 1] / seen[..., 2] / (2.0 * view.matrix[1, 2]))

    return row


def has_rows(observations: Observations) -> bool:
    """Whether the camera's matrix says where the rows of the picture are."""
    return bool(_view(observations).matrix[1, 2] > 0.0)


def _seen_in_frame(field: _Field, measured: Array, observations: Observations) -> Array:
    """(F, m, 3) per unit: what a field does to the poses (F, m, 3) of tags, whose frame has the base tag at its origin
    and the tags at rest along x; zero for tags that were not seen."""
    base = field(np.zeros(2))
    rest = observations.rest_xy[np.all(np.isfinite(observations.rest_xy), axis=-1)]
    reach = float(np.sum(rest**2))
    if reach > 0.0:
        off = field(rest) - base
        frame_turn = float(np.sum(rest[:, 0] * off[:, 1] - rest[:, 1] * off[:, 0])) / reach
    else:
        frame_turn = float(_turn_of(field, np.zeros(2), np.zeros(())))
    xy, angle = np.nan_to_num(measured[..., :2]), np.nan_to_num(measured[..., 2])
    turned = frame_turn * np.stack([-xy[..., 1], xy[..., 0]], axis=-1)
    moved = np.concatenate([field(xy) - base - turned, (_turn_of(field, xy, angle) - frame_turn)[..., None]], axis=-1)
    return np.where(np.isfinite(measured), moved, 0.0)


def _turn_of(field: _Field, xy: Array, angle: Array) -> Array:
    """(...) rad per unit: how a field turns directions `angle` (...) at points (..., 2)."""
    onward = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    slope = (field(xy + _STEP * onward) - field(xy - _STEP * onward)) / (2.0 * _STEP)
    return np.asarray(slope[..., 1] * onward[..., 0] - slope[..., 0] * onward[..., 1])


def _view(observations: Observations) -> View:
    assert observations.source.view is not None
    return observations.source.view
