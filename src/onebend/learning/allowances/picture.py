"""What a camera shows of tags that are not where its model takes them to be: heights, plane and lens, rolling shutter.

The camera's model puts every tag in one plane. A tag at height z over that plane is seen where its ray meets the plane:
`z / D` times its distance from the camera's foot too far out, D being the camera's own height. The plane itself and,
without a calibration, focal length and lens are known from the tags' own squares; what these leave open moves all tags
of all frames together.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from onebend.learning.allowances.allowance import Allowance
from onebend.learning.allowances.course import with_rest
from onebend.records import Array, BoolArray, Observations, View

HEIGHT_SD = 2e-3  # m, of each tag over the plane of all
READOUT_SD = 0.015  # s, from the picture's first row to its last
_STEP = 1e-4  # m, to either side of a place, for the slope of a row
_SMALL = np.finfo(float).tiny


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


def camera(observations: Observations, frames: BoolArray, count: int) -> Allowance:
    """The unknowns of the camera and of the tags' plane, in sds of what the tags' own squares left open; `count`
    frames, those at rest last.

    The frame is fixed to the base tag and to the tags at rest: what turns these turns the frame.
    """
    o = observations
    assert o.by_camera is not None
    bare = ~o.loaded & np.all(np.isfinite(o.xy), axis=(1, 2))
    rest = np.where(np.isfinite(o.rest_xy), o.rest_xy, 0.0)
    at_rest = o.by_camera[bare].mean(axis=0) if bare.any() else np.zeros(o.by_camera.shape[1:])
    reach = float(np.sum(rest**2))
    turn = np.sum(rest[:, 0, None] * at_rest[:, 1] - rest[:, 1, None] * at_rest[:, 0], axis=0) / max(reach, _SMALL)
    basis = np.zeros((count, *o.by_camera.shape[1:]))
    basis[: int(frames.sum())] = _less_turn(o.by_camera[frames], np.nan_to_num(o.xy[frames]), turn)
    basis[int(frames.sum()) :] = _less_turn(at_rest, rest, turn)
    n = basis.shape[-1]
    return Allowance("camera", "poses", "1", tuple(f"camera and plane {i}" for i in range(1, n + 1)), np.ones(n), basis)


def _less_turn(moved: Array, xy: Array, turn: Array) -> Array:
    """(..., m, 3, n) what poses at (..., m, 2) m move by, in a frame that turns by `turn` (n,) rad."""
    turned = np.stack([-xy[..., 1], xy[..., 0], np.ones(xy.shape[:-1])], axis=-1)
    return np.asarray(moved - turned[..., None] * turn)


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


def _view(observations: Observations) -> View:
    assert observations.source.view is not None
    return observations.source.view
