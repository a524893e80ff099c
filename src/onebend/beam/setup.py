"""A learned beam in the set-up that it was learned in: its mounting, the tool that pushes it and the sensor.

A recording tells where a point goes under a logged force far better than it tells k(s): errors of k(s), of the place of
the push, of the clamp, of the force's axes, of the length and others cancel. So all of them are kept, jointly normal
with the coefficients of log k, and predictions take them together. Parts that are new, such as another tool, are drawn
from their priors instead.

The force on the beam is `R(direction) F + e(x, y)`: F is the logged force, e a polynomial of second degree in the
displacement (x, y) of the pushed place over the length. It acts at `s_a L + place + slide t`, t being the turn of the
beam there. The clamp is at `origin` and turned by `clamp + gives t_1`, t_1 being the turn at the first tag. A material
that relaxes has relaxed as far as it had in the recording when the largest force ended.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_ndtr

from onebend.beam.continuation import follow, refine
from onebend.beam.grid import Modes
from onebend.beam.loads import push, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Problem, Resolution, make_problem, share_farther
from onebend.beam.sensitivity import of_clamp_angle, of_stiffness, respond
from onebend.beam.statics import Equilibrium
from onebend.beam.stiffness import LogSpline, RectangularSection, UncertainStiffness
from onebend.errors import MechanicsError
from onebend.record_data import record_from
from onebend.records import Array, BoolArray, IntArray, rotated, unit

Renewed = Literal["contact", "tool", "sensor", "mounting"]  # contact: the same tool touches the beam elsewhere
# The parts of a set-up, the unit of each, and with what they are new.
PARTS: dict[str, tuple[str, tuple[Renewed, ...]]] = {
    "curvature": ("rad", ()),  # (3) Legendre states of the rest curvature; their mean is that of the beam
    "length": ("1", ()),  # its log, over the stated length
    "section": ("1", ()),  # share of the stretch and shear that the set-up's thickness gives, less one
    "relaxation": ("1", ()),  # shares of the stiffness that relax; predictions take k(s), the secant stiffness
    "along": ("m", ()),  # (m) of each tag
    "across": ("m", ()),
    "turn": ("rad", ()),
    "clamp": ("rad", ("mounting",)),
    "clamp gives": ("1", ("mounting",)),
    "origin": ("m", ("mounting",)),  # (2)
    "log k": ("1", ("mounting",)),  # (3) level, slope and bow of log k that are a mounting's own
    "place": ("m", ("contact", "tool")),
    "slide": ("m/rad", ("tool",)),
    "direction": ("rad", ("sensor",)),
    "force error": ("N", ("contact", "sensor")),  # (10) of `posture_terms`: those of x, then those of y
    "gain": ("1", ("sensor",)),  # log of the sensor's scale over that of the sensor that taught k(s)
}
_BEYOND = 1.5  # times the largest force of the recording: beyond, nothing tells how the beam bends
_ERRORS = 10  # coefficients of the force error
MOST_REACHED = 0.9  # part of the curvature that all that relaxes may reach: beyond, no stiffness would be left
_FAR = 30.0  # sds of a normal density: nothing is farther
_ELSEWHERE = 1e-3  # of s: a push as far from that of the recording is a new contact
_PASSES = 4  # of the parts that follow the shape: each pass leaves a few percent of their error
RESOLUTION = Resolution(order=8, widest=0.125)
_FITTED = 6  # Legendre polynomials of log k that the ideal beam differs by
_LENGTH_SD, _CLAMP_SD, _LOG_K_SD = 0.005, 0.02, 0.3  # log, rad, log: by which it may differ
_MISFIT, _EMPHASIS, _LOOSELY = 1e-4, 10.0, 30.0  # of the length; at the points more exact, for the band less
_ROUNDS, _SMALL, _DRAWS = 5, 1e-4, 60
_SHARES, _TURNS = (0.25, 0.5, 0.75, 1.0), (-0.35, 0.0, 0.35)  # of the largest force, rad: where it is compared
_PLACES, _TIP = np.linspace(0.1, 1.0, 10), np.ones(1)


@dataclass(frozen=True)
class SetUp:
    """What a recording told of its set-up; n numbers, p coefficients of log k, m tags."""

    push_s: float  # where the tool was stated to act
    force: tuple[float, float]  # N, the largest logged
    tags: tuple[float, ...]  # (m,) s, as stated
    thickness: float  # m, to which `section` is relative
    sizes: Mapping[str, int]  # of the parts that are there, in order
    mean: Array  # (n,) at the mean of log k
    slope: Array  # (n, p) of the mean with the coefficients of log k
    covariance: Array  # (n, n) that is left once these are known
    prior_sd: Array  # (n,) before the data
    force_sd: float = 0.0  # N, of each axis: error of a push that no part explains
    discrepancy: float = 0.0  # of a displacement: error of a point that no part explains
    angle_discrepancy: float = 0.0  # rad per metre of displacement, likewise of an angle
    times: tuple[float, ...] = ()  # s, of each share that relaxes
    reached: tuple[float, ...] = ()  # part of the curvature that a share of one of each time reaches in the push
    reached_at_largest: tuple[float, ...] = ()  # the same when the largest force ended
    tag_ids: tuple[int, ...] = ()  # (m,) -1: a point of the outline; none in models of before version 10

    def __post_init__(self) -> None:
        n = sum(self.sizes.values())
        if not set(self.sizes) <= set(PARTS):
            raise MechanicsError(f"a set-up has no part {sorted(set(self.sizes) - set(PARTS))[0]!r}")
        shapes = (self.mean.shape, self.slope.shape[:1], self.covariance.shape, self.prior_sd.shape)
        if shapes != ((n,), (n,), (n, n), (n,)):
            raise MechanicsError(f"a set-up of {n} numbers cannot hold arrays of {shapes}")

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Where each part stands."""
        ends = np.cumsum([0, *self.sizes.values()]).tolist()
        return {name: slice(a, b) for name, a, b in zip(self.sizes, ends[:-1], ends[1:], strict=True)}

    @property
    def origin(self) -> Array:
        """(2,) m, where the clamp is in the recording's frame."""
        return self._part(self.mean, "origin", 2)

    def tag_at(self, number: int) -> int:
        """Which of `tags` has this id. Raises `MechanicsError` for a tag that the recording did not have."""
        if number >= 0 and number in self.tag_ids:
            return self.tag_ids.index(number)
        known = ", ".join(str(one) for one in self.tag_ids if one >= 0)
        had = f"; it had {known}" if known else ": the model names none. Learn it again from a recording with tags"
        raise MechanicsError(f"the recording had no tag {number}{had}")

    def offsets(self, x: Array) -> Array:
        """(..., m, 2) m, from the axis to the tags' centres, along and across it there; of numbers (..., n)."""
        size = len(self.tags)
        return np.stack([self._part(x, "along", size), self._part(x, "across", size)], axis=-1)

    def renewed(
        self, new: Iterable[Renewed] = (), *, push_s: float | None = None, length: float | None = None
    ) -> SetUp:
        """The set-up with another tool, another sensor or a new mounting: their parts have their priors again.

        A push stated to be at another `push_s` is a new contact. No tool acts beyond the end of the `length` [m], if
        it is given.
        """
        at, wanted = self.push_s if push_s is None else push_s, set(new)
        if wanted - set(get_args(Renewed)):
            raise MechanicsError(f"new may be of {', '.join(get_args(Renewed))}, got {sorted(wanted)}")
        if abs(at - self.push_s) > _ELSEWHERE:
            wanted.add("contact")
        mean, slope, covariance = self.mean.copy(), self.slope.copy(), self.covariance.copy()
        for name, where in self.columns.items():
            if wanted.isdisjoint(PARTS[name][1]):
                continue
            sd = self.prior_sd[where]
            mean[where], slope[where] = 0.0, 0.0
            if name == "place" and length is not None:
                room = min((1.0 - at) * length / sd[0], _FAR)
                ratio = float(np.exp(-0.5 * room**2 - log_ndtr(room)) / np.sqrt(2.0 * np.pi))  # of density and share
                mean[where], sd = -ratio * sd, sd * np.sqrt(1.0 - room * ratio - ratio**2)
            covariance[where], covariance[:, where] = 0.0, 0.0
            covariance[where, where] = np.diag(sd**2)
        return replace(self, push_s=at, mean=mean, slope=slope, covariance=covariance)

    def draw(self, known: UncertainStiffness, count: int, *, seed: int) -> tuple[Array, Array]:
        """(count, p) coefficients of log k and (count, n) numbers of the set-up, as probable as the data say."""
        rng = np.random.default_rng(seed)
        of_k = rng.standard_normal((count, len(known.mean))) @ _root(known.covariance)
        rest = rng.standard_normal((count, len(self.mean))) @ _root(self.covariance)
        return known.mean + of_k, self.mean + of_k @ self.slope.T + rest

    def bent(
        self,
        beam: Beam,
        known: UncertainStiffness,
        force: Array,
        at: tuple[Array, Array] | None = None,
        *,
        near: Array | None = None,
        gravity: tuple[float, float] = (0.0, 0.0),
    ) -> Bent:
        """The beam under logged forces (T, 2) [N], with log k and numbers `at` (T, p), (T, n); default: their means.

        `near` (T, Q): shapes of similar beams, to stay on their branch; default: each force grows from nothing. `beam`
        gives mass and rest curvature.
        """
        count = len(force)
        coefficients, x = (known.mean[None], self.mean[None]) if at is None else at
        x = np.broadcast_to(x, (count, len(self.mean)))
        push_s = self.push_s

        def part(name: str, size: int = 1) -> Array:
            return self._part(x, name, size)

        still = push(np.zeros((count, 2)), push_s)
        plain = make_problem(beam, still + weight(gravity), RESOLUTION)
        nodes, weights = plain.grid.nodes, plain.weights
        log_k = coefficients @ known.basis(nodes).T + part("log k", 3) @ Modes(3).curvature(nodes).T
        k = np.exp(log_k + (0.0 if known.offset is None else known.offset(nodes)))
        if self.reached_at_largest:
            shares = part("relaxation", len(self.reached))
            left = 1.0 - np.minimum(shares @ np.array([self.reached_at_largest, self.reached]).T, MOST_REACHED)
            k = k * left[:, :1] / left[:, 1:]
        length = beam.length * np.exp(part("length"))
        stretch, shear = RectangularSection(self.thickness).compliance(k, weights, length)
        share = np.maximum(1.0 + part("section"), 0.0) if "section" in self.sizes else np.zeros((1, 1))
        q0 = plain.q0 + (part("curvature", 3) - self._part(self.mean, "curvature", 3)) @ Modes(3).curvature(nodes).T
        logged = np.exp(-part("gain")) * rotated(force, part("direction")[:, 0])
        base = replace(plain, k=k, length=length, q0=q0, stretch=share * stretch, shear=share * shear)
        beyond, farther = (nodes < push_s).astype(float), share_farther(base, np.full(count, push_s))
        rest = follow(replace(base, alpha0=beam.clamp_angle + part("clamp")))
        looked_at = np.array([push_s, self.tags[0]])
        turn, moved = np.zeros((count, 2)), np.zeros((count, 2))
        for _ in range(_PASSES):
            place = part("place") + part("slide") * turn[:, :1]
            alpha0 = part("clamp") + part("clamp gives") * turn[:, 1:]
            acting = logged + _of_terms(part("force error", _ERRORS), moved)
            dead = plain.dead_force + (beyond + place * farther)[..., None] * acting[:, None, :]
            now = replace(base, alpha0=beam.clamp_angle + alpha0, dead_force=dead)
            solved = follow(now) if near is None else refine(now, near)
            near = solved.q
            turn = solved.angle(looked_at) - rest.angle(looked_at)
            moved = self.moved(solved, rest)
        return Bent(self, solved, moved, acting, x)

    def ideal(
        self,
        beam: Beam,
        known: UncertainStiffness,
        *,
        gravity: tuple[float, float] = (0.0, 0.0),
        points: Array = _TIP,
        tags: ArrayLike = -1,
    ) -> tuple[Beam, UncertainStiffness]:
        """The inextensible beam on a rigid clamp that goes where this one goes under the same forces on the beam.

        Length, clamp angle and log k differ, the latter by a few Legendre polynomials, so that places of both meet in
        the recording's frame under forces up to the largest: above all `points` (S,), and tenths of the length. The
        band is as wide as these places spread over draws of log k and set-up while the sensor shows the same force;
        where `tags` (S,) has an id, and not -1, that tag's centre in place of the axis. Raises `MechanicsError`: no
        equilibrium under these forces, or another tag.
        """
        exact, angle = self._with_zeros("direction", "force error", "gain"), float(np.arctan2(*self.force[::-1]))
        turns, sizes = angle + np.array(_TURNS), np.hypot(*self.force) * np.array(_SHARES)
        force = (sizes[:, None, None] * unit(turns)).reshape(-1, 2)
        there = exact.bent(beam, known, force, gravity=gravity)
        if not np.any(there.stands):
            raise MechanicsError("the beam does not stand in its set-up under the forces that it was learned from")
        places = np.concatenate([_PLACES, points])
        seen = np.append(np.full(len(_PLACES), -1), np.broadcast_to(tags, len(points)))
        weights = np.append(np.ones(len(_PLACES)), np.full(len(points), _EMPHASIS))[:, None] / (_MISFIT * beam.length)
        wanted = np.where(there.stands[:, None, None], there.xy(places), np.nan)
        s = np.linspace(0.0, 1.0, 8 * len(known.mean))
        onto = np.linalg.lstsq(known.basis(s), Modes(_FITTED).curvature(s), rcond=None)[0]
        loads = push(force, self.push_s) + weight(gravity)

        def of(c: Array) -> Beam:
            logs = tuple((known.mean + onto @ c[2:]).tolist())
            return replace(
                beam,
                length=beam.length * float(np.exp(c[0])),
                clamp_angle=beam.clamp_angle + float(c[1]),
                stiffness=LogSpline(tuple(known.knots.tolist()), logs, known.degree, known.offset),
                thickness=None,
            )

        c, sd = np.zeros(2 + _FITTED), np.array([_LENGTH_SD, _CLAMP_SD, *[_LOG_K_SD] * _FITTED])
        longer = _SMALL * np.eye(2 + _FITTED)[0]
        for _ in range(_ROUNDS):
            solved = follow(make_problem(of(c), loads, RESOLUTION))
            nodes, k = solved.problem.grid.nodes, solved.problem.k[..., None]
            changes = of_clamp_angle(solved.problem) + of_stiffness(solved, k * Modes(_FITTED).curvature(nodes))
            by_length = (
                follow(make_problem(of(c + longer), loads, RESOLUTION)).xy(places) - solved.xy(places)
            ) / _SMALL
            slopes = np.concatenate([by_length[..., None], respond(solved, changes).xy(places)], axis=-1)
            off = np.nan_to_num(wanted - solved.xy(places))
            c = c + _least_squares(weights[..., None] * slopes, weights * off, sd, c)
        ideal, (logs, numbers) = of(c), self.draw(known, _DRAWS, seed=0)
        shown, rows = self.logged(force, there.moved), np.arange(len(force) - len(_TURNS), len(force))
        at = np.repeat(logs, len(rows), axis=0), np.repeat(numbers, len(rows), axis=0)
        near = np.tile(there.solved.q[rows], (_DRAWS, 1))
        drawn = self.bent(beam, known, np.tile(shown[rows], (_DRAWS, 1)), at, near=near, gravity=gravity)
        off = drawn.axis_at(places, seen).reshape(_DRAWS, len(rows), *wanted.shape[1:]) - wanted[rows]
        off = np.where(drawn.stands.reshape(_DRAWS, -1)[..., None, None], np.nan_to_num(off), 0.0)
        by_k, light = weights[..., None] * slopes[rows, ..., 2:], 1.0 / _LOOSELY
        spread = np.array(
            [_least_squares(light * by_k, light * weights * one, sd[2:], np.zeros(_FITTED)) for one in off]
        )
        assert isinstance(ideal.stiffness, LogSpline)
        mean, covariance = np.array(ideal.stiffness.coefficients), onto @ (spread.T @ spread / _DRAWS) @ onto.T
        return ideal, replace(known, mean=mean, covariance=covariance, gain_sd=0.0, shape=None, nominal=None)

    def moved(self, solved: Equilibrium, rest: Equilibrium) -> Array:
        """(T, 2) displacement of the pushed place from `rest`, over the length."""
        at = np.array([self.push_s])
        return np.asarray((solved.xy(at) - rest.xy(at))[:, 0] / np.reshape(solved.problem.length, (-1, 1)))

    def logged(self, force: Array, moved: Array) -> Array:
        """(T, 2) N that the sensor shows for forces (T, 2) on the beam; `moved` (T, 2) as there."""
        on_sensor = force - _of_terms(self._part(self.mean, "force error", _ERRORS), moved)
        turn = np.full(len(force), -self._part(self.mean, "direction", 1)[0])
        return np.asarray(np.exp(self._part(self.mean, "gain", 1)[0]) * rotated(on_sensor, turn))

    def beyond(self, forces: Array) -> float:
        """How many times as large as in the recording the largest of `forces` (..., 2) [N] is; 0 up to 1.5 times."""
        times = float(np.max(np.linalg.norm(forces, axis=-1), initial=0.0) / np.hypot(*self.force))
        return times if times > _BEYOND else 0.0

    def shown(self, unloaded: Problem, solved: Equilibrium, forces: Array) -> Array:
        """(T, a, 2) N that the sensor shows for `forces` (T, a, 2) on the ideal beam, `solved` under them."""
        moved = self.moved(solved, follow(unloaded))
        out = np.empty_like(forces)
        for i, force in enumerate(np.moveaxis(forces, 1, 0)):
            out[:, i] = self.logged(force, moved)
        return out

    def _with_zeros(self, *names: str) -> SetUp:
        mean = self.mean.copy()
        for name in names:
            mean[self.columns.get(name, slice(0))] = 0.0
        return replace(self, mean=mean)

    def _part(self, x: Array, name: str, size: int) -> Array:
        """(..., size) of numbers (..., n); zeros where the set-up lacks the part."""
        where = self.columns.get(name)
        return np.zeros((*x.shape[:-1], size)) if where is None else x[..., where]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        plain = asdict(self) | {"sizes": dict(self.sizes)}
        return {name: v.tolist() if isinstance(v, np.ndarray) else v for name, v in plain.items()}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> SetUp:
        """From `as_dict`. Raises `MechanicsError` where an entry is missing, unknown or not finite."""
        try:
            found = record_from(SetUp, data)
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            raise MechanicsError(f"describes no set-up ({error})") from error
        if not all(np.all(np.isfinite(np.asarray(v))) for name, v in vars(found).items() if name != "sizes"):
            raise MechanicsError("a set-up holds numbers that are not finite")
        return found


@dataclass(frozen=True)
class Bent:
    """The beam in its set-up under T forces."""

    setup: SetUp
    solved: Equilibrium
    moved: Array  # (T, 2) see `SetUp.moved`
    acting: Array  # (T, 2) N, on the beam
    numbers: Array  # (T, n) of the set-up

    @property
    def stands(self) -> BoolArray:
        """(T,) whether there is a stable equilibrium."""
        return np.asarray(self.solved.converged & self.solved.stable)

    def xy(self, s: Array) -> Array:
        """(T, S, 2) m, places of the beam in the frame of the recording."""
        return np.asarray(self.solved.xy(s) + self.setup._part(self.numbers, "origin", 2)[:, None])

    def point(self, s: float, tag: int | None = None) -> Array:
        """(T, 2) m: the axis at `s`, or the centre of the tag with this id. Raises `MechanicsError`: another tag."""
        return self.xy(np.array([s]))[:, 0] if tag is None else self.tags()[:, self.setup.tag_at(tag), :2]

    def tags(self) -> Array:
        """(T, m, 3) m, m, rad: the tags in that frame."""
        s = np.array(self.setup.tags)
        angle, turn = self.solved.angle(s), self.setup._part(self.numbers, "turn", len(s))
        away = rotated(self.setup.offsets(self.numbers), angle)
        return np.concatenate([self.xy(s) + away, (angle + turn)[..., None]], axis=-1)

    def axis_at(self, s: Array, tags: IntArray) -> Array:
        """(T, S, 2) m: as `xy`; where `tags` (S,) has an id, and not -1, as the tag shows it that is taken to be at its
        mean offset."""
        out, off = self.xy(s), self.setup.offsets(self.numbers) - self.setup.offsets(self.setup.mean)
        for i in np.flatnonzero(tags >= 0):
            out[:, i] += rotated(off[:, self.setup.tag_at(int(tags[i]))], self.solved.angle(s[i : i + 1])[:, 0])
        return out


def posture_terms(moved: Array) -> Array:
    """(..., 5) of displacements (..., 2) over the length: x, y, x^2, x y, y^2."""
    x, y = moved[..., 0], moved[..., 1]
    return np.stack([x, y, x**2, x * y, y**2], axis=-1)


def _of_terms(error: Array, moved: Array) -> Array:
    """(T, 2) N of the error's coefficients (10,) or (T, 10) at displacements (T, 2)."""
    each = error.reshape(*error.shape[:-1], 2, -1)
    return np.asarray(np.sum(each * posture_terms(moved)[:, None, :], axis=-1))


def _root(covariance: Array) -> Array:
    """(n, n) symmetric root of a covariance, the same on every machine."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _least_squares(slopes: Array, off: Array, sd: Array, now: Array) -> Array:
    """(n,) step to the most probable numbers of prior `sd` (n,) about zero, from `now` (n,); noise of sd one."""
    rows = slopes.reshape(-1, len(sd))
    return np.asarray(np.linalg.solve(rows.T @ rows + np.diag(sd**-2), rows.T @ off.ravel() - now / sd**2))
