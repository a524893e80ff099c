"""Where the beam stands in the robot's base: from a push that the robot made, or from a tag on its tool.

The beam's frame lies at `origin + rotation (x, y, 0)` in the base. While the robot pushes, its own pose and the film
both say where the tool is:

    rotation (x_i, y_i, 0) + origin = p_i + Q_i o

with p_i, Q_i the tool's pose, (x_i, y_i) where the film has the beam's pushed point (o is then nearly 0) or the tag (o
its place on the tool). Least squares; the axes of the force log in recording.toml are the prior.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from onebend.drive.robots import ToolPose, pose_of
from onebend.errors import RecordingError
from onebend.live.force_sensors import TOOL
from onebend.recording import camera, entries, signals, tables, tags
from onebend.recording.observe import observe
from onebend.records import Array, Observations

TILT_SD = math.radians(2.0)  # of the plane of bending against the plane of the log's two axes
CONTACT_SD, ON_TOOL_SD = 0.003, 0.2  # m, of o: where the tool touches, and where a tag sits on it
NOISE = 1e-4  # m, of one pair at least: tags and encoders are no better together
TOUCH_SD = 1e-3  # m, of a tool that was brought to the beam by eye
INDEPENDENT = 10.0  # pairs of a push count for so many
FEWEST = 20  # pairs, and
MOST_OFF = 0.1  # of the way, that pairs may be off by
LEAST_WAY = 0.2  # of the beam's length that they spread over


@dataclass(frozen=True)
class Placement:
    """The beam's frame in the robot's base, and how exactly it is known."""

    rotation: Array  # (3, 3), x and y of the beam and the plane's normal
    origin: Array  # (3,) m
    covariance: Array  # (6, 6) of a small turn about `pivot` [rad] and a shift there [m], in the base
    pivot: Array  # (3,) m, in the base
    noise: float  # m, what pairs are off by
    source: str  # in words

    def to_base(self, xy: Array) -> Array:
        """(3,) m in the base of a place (2,) m in the plane."""
        return np.asarray(self.origin + self.rotation[:, :2] @ xy)

    def to_beam(self, position: Array) -> Array:
        """(3,) m in the beam's frame of a place (3,) in the base; the last is its height over the plane."""
        return np.asarray((position - self.origin) @ self.rotation)

    def sd(self, xy: Array) -> float:
        """m, of a place (2,) in the plane as the robot goes there (root of the mean of both axes)."""
        arm = self.to_base(xy) - self.pivot
        moved = np.hstack([-_cross(arm), np.eye(3)])
        spread = self.rotation[:, :2].T @ moved @ self.covariance @ moved.T @ self.rotation[:, :2]
        return math.hypot(math.sqrt(0.5 * float(np.trace(spread))), self.noise)

    def moved_to(self, position: Array, xy: Array) -> Placement:
        """The same axes, where the tool is at `position` (3,) m as it touches the beam at `xy` (2,) m."""
        known = self.covariance.copy()
        known[3:], known[:, 3:] = 0.0, 0.0
        known[3:, 3:] = TOUCH_SD**2 * np.eye(3)
        origin = position - self.rotation[:, :2] @ xy
        return replace(self, origin=origin, covariance=known, pivot=np.asarray(position, dtype=float))


def axes_of(force: entries.ForceEntry) -> Array:
    """(3, 3) the beam's axes in the robot's base, where the force log is in the axes of that base.

    Raises:
        RecordingError: its columns name no axes.
    """
    letters = [name[:2] for name in force.columns[1:]]
    if force.topic:
        first, other = (_unit(name) for name in force.axes)
    elif all(one in ("fx", "fy", "fz") for one in letters):
        first, other = (_unit(name[1]) for name in letters)
    else:
        raise RecordingError(
            f"[force] columns are {', '.join(force.columns[1:])}, which does not say along which axes of the robot's "
            "base the forces are. Record the push with the robot's own wrench (fx_N, fy_N, fz_N)."
        )
    cos, sin = math.cos(force.rotation), math.sin(force.rotation)
    x, y = cos * first - sin * other, sin * first + cos * other
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _unit(axis: str) -> Array:
    out = np.zeros(3)
    out["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return out


def stated_placement(rec: entries.Recording) -> Placement:
    """What recording.toml alone says: axes as good as it says, and no place.

    Raises:
        RecordingError: it has no [force] in axes of the robot's base.
    """
    if rec.force is None:
        raise RecordingError(f"{rec.folder}: [force] in recording.toml says how the robot's base lies. Add it.")
    rotation, sds = axes_of(rec.force), np.array([TILT_SD, TILT_SD, rec.direction_sd])
    turn = rotation @ np.diag(sds**2) @ rotation.T
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = turn
    return Placement(rotation, np.zeros(3), covariance, np.zeros(3), 0.0, "the axes in recording.toml")


def fitted(seen: Array, tool: Sequence[ToolPose], prior: Placement, offset_sd: float, source: str) -> Placement:
    """From places (N, 2) m in the beam's frame and the tool's poses at the same moments.

    Raises:
        RecordingError: they contradict each other.
    """
    base, turns = np.array([one.position for one in tool]), np.stack([one.rotation for one in tool])
    flat = np.column_stack([seen, np.zeros(len(seen))])
    known = np.linalg.cholesky(np.linalg.inv(prior.covariance[:3, :3])).T
    share = math.sqrt(min(INDEPENDENT / len(seen), 1.0))  # what is left comes with the force, pair after pair

    def turned(x: Array) -> Array:
        return np.asarray(Rotation.from_rotvec(x[:3]).as_matrix() @ prior.rotation)

    def off(x: Array) -> Array:
        return np.asarray(base + turns @ x[6:] - flat @ turned(x).T - x[3:6])

    def left(x: Array, sd: float) -> Array:
        return np.concatenate([share / sd * off(x).ravel(), known @ x[:3], x[6:] / offset_sd])

    x, sd = np.concatenate([np.zeros(3), np.mean(base - flat @ prior.rotation.T, axis=0), np.zeros(3)]), 1e-3
    for _ in range(8):
        found = least_squares(left, x, x_scale="jac", args=(sd,))
        x, sd = found.x, max(float(np.sqrt(np.mean(off(found.x) ** 2))), NOISE)
    rotation, origin, pivot = turned(x), x[3:6], base.mean(axis=0)
    turn = np.linalg.norm(x[:3])
    if turn > 5.0 * math.sqrt(np.trace(prior.covariance[:3, :3])) or sd > MOST_OFF * float(np.ptp(seen, axis=0).max()):
        raise RecordingError(
            f"{source}: the robot and the film disagree on where the tool went, whatever the axes. Check columns, "
            "rotation_deg and acts_on of [force], and that the robot's tool centre is where it touches the beam."
        )
    at_pivot = np.eye(9)
    at_pivot[3:6, :3] = -_cross(pivot - origin)
    covariance = (at_pivot @ np.linalg.inv(found.jac.T @ found.jac) @ at_pivot.T)[:6, :6]
    return Placement(rotation, origin, covariance, pivot, sd, source)


def from_recording(rec: entries.Recording, *, tool_tag: int | None = None) -> Placement:
    """From a recorded push whose force log has the robot's pose; by the pushed point, or by a tag on the tool.

    Raises:
        RecordingError: the log has no pose, or the push is too short.
        ObservationError: as `observe`.
    """
    prior = stated_placement(rec)
    time, poses = _logged_poses(rec)
    made = observe(rec)
    when, seen = _pushed_points(made) if tool_tag is None else _tool_tags(rec, made, tool_tag)
    inside = (when >= time[0]) & (when <= time[-1])
    when, seen = when[inside], seen[inside]
    what = "the push" if tool_tag is None else f"tag {tool_tag} on the tool"
    if len(when) < FEWEST or float(np.ptp(seen, axis=0).max(initial=0.0)) < LEAST_WAY * made.length:
        way = 1e3 * float(np.ptp(seen, axis=0).max(initial=0.0))
        raise RecordingError(
            f"{rec.folder}: {what} is seen in {len(when)} frames over {way:.3g} mm, too few to place "
            "the robot. Record a push over half the beam's length."
        )
    vectors = np.stack([np.interp(when, time, column) for column in poses.T], axis=1)
    tool = [pose_of(row) for row in vectors]
    return fitted(seen, tool, prior, CONTACT_SD if tool_tag is None else ON_TOOL_SD, f"{what} of {rec.name}")


def _logged_poses(rec: entries.Recording) -> tuple[Array, Array]:
    """(N,) s and (N, 6) of the robot's tool, from the columns that `record` writes."""
    assert rec.force is not None
    advice = "Record the push with --force ur:HOST or franka:HOST, or say --place start."
    table = tables.read_columns(rec.force.file, ("time_s", *TOOL), kind="force log", advice=lambda _: advice)
    poses = np.stack(list(table.numbers.values()), axis=1)
    poses = poses[np.isfinite(poses).all(axis=1)]
    poses[:, 4:] = np.unwrap(poses[:, 4:], axis=0)
    return poses[:, 0], poses[:, 1:]


def _pushed_points(made: Observations) -> tuple[Array, Array]:
    """(T,) s on the log's clock and (T, 2) m of the pushed point while the beam is loaded, between the tags seen."""
    times, places = [], []
    for t in np.flatnonzero(made.loaded & np.isfinite(made.push_s)).tolist():
        known = np.isfinite(made.xy[t]).all(axis=-1) & np.isfinite(made.angle[t])
        if known.any():
            times.append(made.time[t])
            axis = signals.along_tags(made.marker_s[known], made.xy[t, known], made.angle[t, known], made.length)
            places.append(axis(made.push_s[t]))
    return np.array(times), np.array(places).reshape(-1, 2)


def _tool_tags(rec: entries.Recording, made: Observations, tag: int) -> tuple[Array, Array]:
    """The same of a tag on the tool."""
    view, clock = made.source.view, made.source.clock
    if rec.video is None or view is None or clock is None:
        raise RecordingError(f"{rec.folder}: a tag on the tool is seen in a film alone, and this recording has none.")
    found = tags.detect_tags(rec.video, replace(rec.tags, on_beam=(*rec.tags.on_beam, entries.TagEntry(id=tag, s=1.0))))
    corners, view = found.corners[:, -1:], replace(view, lying=view.lying[:0])
    poses, _, _ = camera.measure_poses(view, corners, rec.tags.size, noise=max(view.corner_sd, 0.02))
    shown = np.isfinite(poses.xy[:, 0]).all(axis=-1)
    return found.time[shown] + clock.offset, poses.xy[shown, 0]


def _cross(arms: Array) -> Array:
    """(..., 3, 3): `_cross(a) @ b` is a x b."""
    return np.asarray(np.cross(np.eye(3), np.asarray(arms)[..., None, :]))
