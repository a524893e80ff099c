"""Target shapes, goals that move, and their files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator, make_interp_spline

from onebend.beam.problem import Problem
from onebend.beam.setup import SetUp
from onebend.beam.statics import Equilibrium
from onebend.errors import ControlError, MechanicsError
from onebend.records import Array, BoolArray, IntArray
from onebend.text_files import csv_rows, listed_columns, quoted

ComplexArray = NDArray[np.complex128]

BEYOND = 2.0  # lengths from the clamp: a farther target is a mistake
METRES = "Positions are in metres: is this in millimetres?"


@dataclass(frozen=True)
class Targets:
    """Wanted positions and angles at N places; NaN where free.

    Minimised is `sum_i weight_i (|r(s_i) - xy_i|^2 + arm^2 (alpha(s_i) - angle_i)^2)`; the default arm is the beam's
    length.
    """

    s: Array  # (N,)
    xy: Array  # (N, 2) m, in the beam's frame
    angle: Array  # (N,) rad, counting full turns
    weight: Array  # (N,) 1
    tag: IntArray = field(default_factory=lambda: np.full(1, -1))  # (N,) id of the tag at the place; -1: the axis
    offset: Array = field(default_factory=lambda: np.zeros((1, 2)))  # (N, 2) m, of its centre, along and across

    def __post_init__(self) -> None:
        count = len(self.s)
        object.__setattr__(self, "tag", np.broadcast_to(self.tag, (count,)))
        object.__setattr__(self, "offset", np.broadcast_to(self.offset, (count, 2)))
        if count == 0 or self.xy.shape != (count, 2) or self.angle.shape != (count,) or self.weight.shape != (count,):
            raise ControlError(f"targets need at least one place, and a value for each; got {count} places")
        if not np.all((self.s >= 0.0) & (self.s <= 1.0)):
            raise ControlError(f"targets are at s in [0, 1], got {self.s[~((self.s >= 0) & (self.s <= 1))][0]}")
        if not np.all(np.isfinite(self.weight) & (self.weight > 0.0)):
            raise ControlError("a target's weight must be a positive number; leave out what does not count")
        if np.any(np.isinf(self.xy)) or np.any(np.isinf(self.angle)):
            raise ControlError("a target's position and angle must be finite, or NaN where of no concern")
        if np.any(np.isnan(self.xy[:, 0]) != np.isnan(self.xy[:, 1])):
            raise ControlError("a target has both x and y, or neither")
        if np.any(np.isnan(self.xy[:, 0]) & np.isnan(self.angle)):
            raise ControlError("a target has neither a position nor an angle; leave it out")

    @property
    def placed(self) -> BoolArray:
        """(N,) whether a position is wanted."""
        return np.asarray(np.isfinite(self.xy[:, 0]))

    @property
    def turned(self) -> BoolArray:
        """(N,) whether an angle is wanted."""
        return np.asarray(np.isfinite(self.angle))

    def __add__(self, other: Targets) -> Targets:
        return Targets(*(np.concatenate(both) for both in zip(vars(self).values(), vars(other).values(), strict=True)))

    def rows(self, problem: Problem) -> ComplexArray:
        """(N, Q) w: the places over L are `w @ exp(i alpha)`, x + i y, of the angles (Q,) at the nodes."""
        off = self.offset @ np.array([1.0, 1.0j]) / float(problem.length)
        return np.asarray(problem.grid.integral_to(self.s) + off[:, None] * problem.grid.value_at(self.s))

    def places(self, solved: Equilibrium) -> Array:
        """(T, N, 2) m, where the points of the beam are that have targets."""
        there = float(solved.problem.length) * np.exp(1j * solved.alpha) @ self.rows(solved.problem).T
        return np.stack([there.real, there.imag], axis=-1)


def numbers(values: ArrayLike) -> str:
    """For a message."""
    return f"({', '.join(f'{one:g}' for one in np.ravel(np.asarray(values, dtype=float)))})"


def check_metres(xy: Array, length: float) -> None:
    """Raises `ControlError` for positions (N, 2) that cannot be in metres."""
    away = np.nan_to_num(np.linalg.norm(xy, axis=-1)).ravel()
    if away.size and np.max(away) > BEYOND * length:
        worst = np.reshape(xy, (-1, 2))[int(np.argmax(away))]
        where = f"the position {numbers(worst)} m is {np.max(away):.4g} m from the clamp"
        raise ControlError(f"{where}, the beam {length:.4g} m long. {METRES}")


def points(s: ArrayLike, xy: ArrayLike, *, weight: ArrayLike = 1.0) -> Targets:
    """Positions xy (N, 2) or (2,) m at places s (N,) or a number."""
    places = np.atleast_1d(np.asarray(s, dtype=float))
    wanted = np.atleast_2d(np.asarray(xy, dtype=float))
    if wanted.shape != (len(places), 2):
        raise ControlError(f"{len(places)} places need positions of shape ({len(places)}, 2), got {np.shape(xy)}")
    return Targets(places, wanted, np.full(len(places), np.nan), _spread(weight, len(places)))


def tags(setup: SetUp, number: ArrayLike, xy: ArrayLike, *, weight: ArrayLike = 1.0) -> Targets:
    """Positions xy (N, 2) or (2,) m of the centres of tags, by their ids (N,) or one, as the recording saw them.

    Raises `MechanicsError` for a tag that the recording did not have.
    """
    every = np.atleast_1d(np.asarray(number))
    which = [setup.tag_at(int(one)) for one in every]
    wanted = points(np.array(setup.tags)[which], xy, weight=weight)
    return replace(wanted, tag=every, offset=setup.offsets(setup.mean)[which])


def angles(s: ArrayLike, angle: ArrayLike, *, weight: ArrayLike = 1.0) -> Targets:
    """Tangent angles (N,) or a number [rad] at places s (N,) or a number."""
    places = np.atleast_1d(np.asarray(s, dtype=float))
    wanted = np.atleast_1d(np.asarray(angle, dtype=float))
    if wanted.shape != places.shape:
        raise ControlError(f"{len(places)} places need as many angles, got {len(wanted)}")
    return Targets(places, np.full((len(places), 2), np.nan), wanted, _spread(weight, len(places)))


def curve(s: ArrayLike, xy: ArrayLike) -> Targets:
    """A curve xy (N, 2) m at rising s (N,), weighted by spacing: the sum of squares is the integral along the curve."""
    places = np.asarray(s, dtype=float)
    if places.ndim != 1 or len(places) < 2 or not np.all(np.diff(places) > 0.0):
        raise ControlError("a curve needs two or more points at rising s")
    step = np.diff(places)
    return points(places, xy, weight=0.5 * (np.append(step, 0.0) + np.append(0.0, step)))


def curve_of_length(xy: ArrayLike, length: float) -> Targets:
    """A curve from the clamp as points (N, 2) m; s is their arc length over L.

    Raises `ControlError` for a curve longer than the beam (`length`, m) by more than 1e-6 of it.
    """
    drawn = np.asarray(xy, dtype=float)
    if drawn.ndim != 2 or drawn.shape[1] != 2 or len(drawn) < 2 or not np.all(np.isfinite(drawn)):
        raise ControlError(f"a curve is two or more points (N, 2), finite; got an array of shape {np.shape(xy)}")
    s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(drawn, axis=0), axis=1))) / length
    if s[-1] > 1.0 + 1e-6:
        raise ControlError(f"the curve is {s[-1] * length:.6g} m long, the beam {length:.6g} m; shorten the curve")
    return curve(np.minimum(s, 1.0), drawn)


def _spread(weight: ArrayLike, count: int) -> Array:
    return np.array(np.broadcast_to(np.asarray(weight, dtype=float), (count,)))


@dataclass(frozen=True)
class TargetResiduals:
    """Weighted residuals of T shapes, and derivatives by the curvature at the nodes; over L."""

    value: Array  # (T, R)
    jacobian: Array  # (T, R, Q)
    curvature_term: Array  # (T, Q): `sum_i value_i d2 value_i / dq2 = B^T diag(curvature_term) B`

    @property
    def cost(self) -> Array:
        """(T,) sum of squares."""
        return np.asarray(np.sum(self.value**2, axis=-1))


def target_residuals(solved: Equilibrium, targets: Targets, arm: float) -> TargetResiduals:
    """Of one shape; `arm` [m] per rad."""
    return target_residuals_along(solved, targets, targets.xy[None], targets.angle[None], arm)


def target_residuals_along(
    solved: Equilibrium, targets: Targets, xy: Array, angle: Array, arm: float
) -> TargetResiduals:
    """Of T shapes with targets xy (T, N, 2) and angle (T, N), at the places and weights of `targets`."""
    problem, length = solved.problem, float(solved.problem.length)
    placed, turned, root = targets.placed, targets.turned, np.sqrt(targets.weight)
    direction, at = np.exp(1j * solved.alpha), root[placed, None] * targets.rows(problem)[placed]  # (T, Q), (n, Q)
    off = direction @ at.T - root[placed] * (xy[:, placed] @ np.array([1.0, 1.0j])) / length
    moved = 1j * direction[:, None] * at
    lever, to = root[turned] * arm / length, problem.grid.integral_to(targets.s)[turned]
    twisted = lever * (solved.angle(targets.s)[:, turned] - angle[:, turned])
    turning = np.broadcast_to(lever[:, None] * to, (len(direction), *to.shape))
    return TargetResiduals(
        np.concatenate([off.real, off.imag, twisted], axis=1),
        np.concatenate([np.concatenate([moved.real, moved.imag], axis=1) @ problem.to_nodes, turning], axis=1),
        -np.real((off.conj() @ at) * direction),
    )


Between = Literal["smooth", "monotone", "linear"]


@dataclass(frozen=True)
class Goals:
    """Targets at N places over K times.

    `between`: "smooth" is a cubic spline, which may overshoot; "monotone" does not, but acceleration jumps at goals;
    "linear" is straight, with jumps of velocity. Motion starts and ends at rest only if the goals do.
    """

    time: Array  # (K,) s, rising
    targets: Targets  # places, weights, and the first targets
    xy: Array  # (K, N, 2) m; NaN where free, at all times
    angle: Array  # (K, N) rad
    between: Between = "smooth"
    warnings: tuple[str, ...] = ()  # of who made them

    def __post_init__(self) -> None:
        count, places = len(self.time), len(self.targets.s)
        if count < 2 or self.xy.shape != (count, places, 2) or self.angle.shape != (count, places):
            raise ControlError(f"a path needs two or more times with values for each of its {places} places")
        if not np.all(np.isfinite(self.time)) or not np.all(np.diff(self.time) > 0.0):
            at = int(np.argmin(np.diff(self.time))) + 1
            raise ControlError(f"the times of a path must rise; time {at + 1} is {self.time[at]:g} s")
        if np.any(np.isinf(self.xy)) or np.any(np.isinf(self.angle)):
            raise ControlError("positions and angles along a path must be finite, or NaN where of no concern")
        same = np.all(np.isfinite(self.xy) == self.targets.placed[:, None], axis=(1, 2))
        same &= np.all(np.isfinite(self.angle) == self.targets.turned, axis=1)
        if not np.all(same):
            raise ControlError(
                f"at {self.time[np.argmin(same)]:g} s other things are wanted than at the start; "
                "every place needs its position, or its angle, at all times or at none"
            )

    def along(self, time: Array) -> tuple[Array, Array]:
        """xy (T, N, 2) m and angle (T, N) rad at times (T,) s."""
        flat = np.concatenate([self.xy.reshape(len(self.time), -1), self.angle], axis=1)
        known = np.isfinite(flat[0])
        out = np.full((len(time), flat.shape[1]), np.nan)
        out[:, known] = _curve(self.time, flat[:, known], self.between)(np.clip(time, self.time[0], self.time[-1]))
        split = self.xy.shape[1] * 2
        return out[:, :split].reshape(len(time), -1, 2), out[:, split:]

    def at(self, time: float) -> Targets:
        xy, angle = self.along(np.array([time]))
        return replace(self.targets, xy=xy[0], angle=angle[0])


def _curve(time: Array, values: Array, between: Between) -> Callable[[Array], Array]:
    """Values (K, c) as functions of time; the degree is lower with fewer than four goals."""
    if between == "monotone":
        return PchipInterpolator(time, values)  # type: ignore[no-any-return]
    return make_interp_spline(time, values, k=min(3, len(time) - 1) if between == "smooth" else 1)  # type: ignore[no-any-return]


TARGET_COLUMNS = ("s", "tag", "x_m", "y_m", "angle_rad", "weight")
GOAL_COLUMNS = ("time_s", *TARGET_COLUMNS)
MOST_GOALS = 100_000
LARGEST = 1e30  # m, rad, s
WITHOUT_SETUP = (
    "where the tags are on the beam stands in the set-up of the recording, which the model lacks or which is not "
    "used; give s in place of the tag"
)
_VALUES = ("x_m", "y_m", "angle_rad")
_MAY_BE_BLANK = ("s", "tag", *_VALUES)


def read_targets(path: Path, length: float, setup: SetUp | None = None) -> Targets:
    """Targets from a CSV with columns of `TARGET_COLUMNS`, one row per place.

    Blank cells and absent columns are free; the default weight is 1. Without `s` and `tag` the rows are a curve from
    the clamp, on a beam of `length` m. A `tag` is one of the recording of the `setup`.

    Raises `ControlError` with file and line: missing file, unknown or missing columns, a bad cell or value, a tag
    without a set-up or that the recording did not have.
    """
    table = _table(path, TARGET_COLUMNS)
    if "s" not in table and "tag" not in table:
        _need(path, table, ("x_m", "y_m"), "targets without a column s are a drawn curve")
        with _in(path):
            return curve_of_length(np.stack([table["x_m"], table["y_m"]], axis=1), length)
    _on_beam(path, table, setup)
    with _in(path):
        return _targets(table, slice(None))


def read_goals(
    path: Path,
    *,
    point_s: float = 1.0,
    tag: int | None = None,
    between: Between = "smooth",
    setup: SetUp | None = None,
) -> Goals:
    """Goals from a CSV with columns of `GOAL_COLUMNS`, one row per place and time, with the same places at every time.

    Without `s` and `tag` the rows are positions of the point at `point_s`, or of the centre of the `tag`.

    Raises `ControlError` as `read_targets`, and for missing places or times that do not rise.
    """
    table = _table(path, GOAL_COLUMNS)
    _need(path, table, ("time_s",), "a path needs times")
    if "s" not in table and "tag" not in table:
        table["s" if tag is None else "tag"] = np.full(len(table["time_s"]), point_s if tag is None else tag)
    _on_beam(path, table, setup)
    time, first = np.unique(table["time_s"], return_index=True)
    if np.any(np.diff(table["time_s"]) < 0.0):
        line = int(table["line"][np.argmax(np.diff(table["time_s"]) < 0.0) + 1])
        raise ControlError(f"{path}, line {line}: the times must rise; this one is earlier than that before it")
    ends = np.append(first[1:], len(table["time_s"]))
    count = int(ends[0] - first[0])
    for a, b in zip(first, ends, strict=True):
        if b - a != count or any(np.any(table[name][a:b] != table[name][:count]) for name in ("s", "tag")):
            raise ControlError(
                f"{path}, line {int(table['line'][a])}: at {table['time_s'][a]:g} s there are other places than at the "
                "first time; give the same rows of s or tag for every time"
            )
    with _in(path):
        every = [_targets(table, slice(a, a + count)) for a in first]
        xy, angle = np.stack([row.xy for row in every]), np.stack([row.angle for row in every])
        return Goals(time, every[0], xy, angle, between)


def _targets(table: dict[str, Array], rows: slice) -> Targets:
    s = table["s"][rows]
    x, y, angle = (table[name][rows] if name in table else np.full(len(s), np.nan) for name in _VALUES)
    weight = table["weight"][rows] if "weight" in table else np.ones(len(s))
    return Targets(s, np.stack([x, y], axis=1), angle, weight, table["tag"][rows].astype(int), table["offset"][rows])


def _on_beam(path: Path, table: dict[str, Array], setup: SetUp | None) -> None:
    """Each row's `s`, `tag` (-1: none) and `offset` (2,), from its `s` or its `tag`."""
    blank = np.full(len(table["line"]), np.nan)
    s, tag = (table.get(name, blank).copy() for name in ("s", "tag"))
    if np.any(wrong := np.isfinite(s) == np.isfinite(tag)):
        raise ControlError(f"{path}, line {int(table['line'][np.argmax(wrong)])}: a row has an s, or a tag, not both")
    tagged = np.isfinite(tag)
    table |= {"s": s, "tag": np.where(tagged, tag, -1), "offset": np.zeros((len(s), 2))}
    if tagged.any():
        if setup is None:
            raise ControlError(f"{path}: {WITHOUT_SETUP}")
        with _in(path):
            there = tags(setup, tag[tagged], np.zeros((np.sum(tagged), 2)))
        s[tagged], table["offset"][tagged] = there.s, there.offset


@contextmanager
def _in(path: Path) -> Iterator[None]:
    """Adds the file to errors."""
    try:
        yield
    except (ControlError, MechanicsError) as error:
        raise ControlError(f"{path}: {error}") from error


def _need(path: Path, table: dict[str, Array], names: tuple[str, ...], why: str) -> None:
    missing = [name for name in names if name not in table]
    if missing:
        raise ControlError(f"{path}, line 1: no column {missing[0]}; {why}")


def _table(path: Path, known: tuple[str, ...]) -> dict[str, Array]:
    reader = csv_rows(path, ControlError)
    header = [cell.strip() for cell in next(reader, (1, []))[1]]
    for name in header:
        if name not in known or header.count(name) > 1:
            what = "stands twice" if name in known else "is not known"
            shown = quoted(name) if listed_columns(path, [name]) else "in its first line"
            raise ControlError(f"{path}, line 1: column {shown} {what}; the columns are {', '.join(known)}")
    rows: list[list[float]] = []
    for line, cells in reader:
        if len(rows) == MOST_GOALS:
            raise ControlError(f"{path}, line {line}: at most {MOST_GOALS} rows are read; give fewer, farther apart")
        if len(cells) != len(header):
            raise ControlError(f"{path}, line {line}: {len(cells)} cells, but {len(header)} columns")
        where = f"{path}, line {line}"
        rows.append([line, *(_number(where, n, c) for n, c in zip(header, cells, strict=True))])
    if not rows:
        raise ControlError(f"{path}: no rows; the first line names the columns ({', '.join(known)})")
    return dict(zip(["line", *header], np.array(rows).T, strict=True))


def _number(where: str, name: str, cell: str) -> float:
    if not cell.strip() and name in _MAY_BE_BLANK:
        return float("nan")
    try:
        value = float(cell)
    except ValueError as error:
        raise ControlError(f"{where}: {name} is {quoted(cell.strip())}, not a number") from error
    if name == "tag" and not (value >= 0.0 and value.is_integer()):
        raise ControlError(f"{where}: tag is {value:g}; it is the id of a tag in recording.toml")
    if not abs(value) <= LARGEST:
        raise ControlError(f"{where}: {name} is '{cell.strip()}'; leave a cell blank where it is of no concern")
    if name == "s" and not 0.0 <= value <= 1.0:
        raise ControlError(f"{where}: s is {value:g}; places are from 0 (clamp) to 1 (tip)")
    if name == "weight" and not value > 0.0:
        raise ControlError(f"{where}: weight is {value:g}; it must be positive")
    return value
