"""Bend: a learned beam whose point or end is dragged."""

from __future__ import annotations

import itertools
import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from contourpy import contour_generator
from PIL import Image, ImageDraw
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.spatial import cKDTree

from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, has_mass
from onebend.beam.setup import SetUp
from onebend.beam.stiffness import UncertainStiffness
from onebend.control.loaded_beam import LoadedState, PushedBeam
from onebend.control.loop_simulation import AXIS_PLACES
from onebend.control.reach import ReachCandidate, predicted_error
from onebend.control.reach_set import DragAnswer, DraggedPoint, Edge, HeldEnd, ReachMap, reach_map
from onebend.errors import ControlError, StudioError
from onebend.records import Array, BoolArray
from onebend.results.model import StoredModel, read_model
from onebend.studio.places import StudioFolder
from onebend.studio.words import Asked, line, places_of, rounded

# Slow work for a separate process: reachable set, edge of a hand, ellipse. Beams are sent as plain data and cached.

DRAWS = 200  # beams for the ellipse of a resting point
BEGIN_TURN = 0.35  # rad, initial turn of the tip
LARGEST_TIMES = 2.0  # times `bending_force`: default bound


def bending_force(beam: Beam) -> float:
    """N across the tip that would turn it by about a radian if linear."""
    s = np.linspace(0.0, 1.0, 201)
    return 1.0 / (float(np.mean((1.0 - s) ** 2 / np.asarray(beam.stiffness(s)))) * beam.length)


def beam_data(places: StudioFolder, asked: Asked) -> dict[str, Any]:
    """The beam at rest, and an initial goal. Raises `ResultsError` for an unreadable model."""
    name = asked.name()
    stored = read_model(places.result(name))
    beam = stored.beam
    force = BEGIN_TURN * bending_force(beam)
    return {
        "name": name,
        "length_m": beam.length,
        "rest_m": np.round(beam.equilibrium((0.0, 0.0)).xy(AXIS_PLACES), 6),
        "goal_m": np.round(beam.equilibrium((force, 2.0 * force)).xy(1.0), 4).tolist(),
        "band": stored.uncertain is not None,
        "mass": has_mass(beam),
        "doubts": [] if stored.uncertain is None else list(stored.uncertain.doubts),
    }


def reach_asked(places: StudioFolder, asked: Asked) -> tuple[str, float, float, float]:
    """Beam as JSON, two places, largest force [N]. Raises `StudioError` for an invalid request."""
    beam = read_model(places.result(asked.name("model"))).beam
    most = asked.number_if_any("max_force_N") or LARGEST_TIMES * bending_force(beam)
    return json.dumps(beam.as_dict(), sort_keys=True), asked.number("push_s"), asked.number("point_s"), most


@lru_cache(maxsize=4)
def pushed_beam(beam: str, push_s: float, point_s: float) -> PushedBeam:
    """From JSON."""
    return PushedBeam(Beam.from_dict(json.loads(beam)), push_s, point_s, resolution=Resolution())


def make_map(beam: str, push_s: float, point_s: float, max_force: float) -> ReachMap:
    return reach_map(pushed_beam(beam, push_s, point_s), max_force)


def hand_edge(beam: str, q: Array, load: Array, max_force: float) -> list[tuple[list[float], str]]:
    """How far a hand can go from a state without turning, in all directions."""
    held = HeldEnd(pushed_beam(beam, 1.0, 1.0), LoadedState(q, load), max_force)
    return [(end.tolist(), limit) for end, limit in held.edge()]


def full_ellipse(
    beam: str, uncertain: Mapping[str, Any], push_s: float, point_s: float, q: Array, load: Array
) -> dict[str, Any] | None:
    """The 95 % ellipse by drawn beams; None if too few are stable."""
    pushed = pushed_beam(beam, push_s, point_s)
    known = UncertainStiffness.from_dict(dict(uncertain))
    return ellipse_of(pushed, known, LoadedState(q, load), DRAWS)


def ellipse_of(
    pushed: PushedBeam, known: UncertainStiffness, state: LoadedState, draws: int = 0
) -> dict[str, Any] | None:
    """The 95 % ellipse; without draws to first order."""
    try:
        error = predicted_error(pushed.beam, known, ReachCandidate(pushed, (pushed.start, state), 0), draws=draws)
    except ControlError:
        return None
    ellipse = error.ellipse()
    if not np.all(np.isfinite(ellipse.semi_axes)):
        return None
    return {
        "outline_m": (error.mean + ellipse.outline(49)).tolist(),
        "semi_axes_m": ellipse.semi_axes.tolist(),
        "draws": draws,
        "lost": error.lost,
    }


PLACES = np.linspace(0.0, 1.0, 61)  # of the drawn line
Mode = Literal["point", "hand"]
_SAME_SHARE, _SAME_FORCE = 1e-2, 1e-4  # relative, and N: accuracy of the shown command
_SAME_PLACE = 1e-10  # m: accuracy of `onebend reach` on its own grid
MOST_DIGITS = 12  # decimals of a goal in metres


@dataclass
class Bending:
    """One learned beam under the pointer; for one thread."""

    model: str  # name on page and command line
    learned: StoredModel
    stored: StoredModel  # with the ideal beam that goes where the learned one goes in its set-up, for a point
    beam: str  # its JSON
    largest_first: float  # N
    push_s: float = 1.0
    point_s: float = 1.0
    max_force: float = 0.0  # N
    mode: Mode = "point"
    point: DraggedPoint = field(init=False)
    hand: HeldEnd | None = None
    setup: SetUp | None = None  # whose sensor shows the force; None for a hand, or a model without one
    version: int = 0  # of the settings, for maps

    def __post_init__(self) -> None:
        self.max_force = self.max_force or self.largest_first
        self._renew(None)

    @property
    def pushed(self) -> PushedBeam:
        return self.point.pushed

    @property
    def state(self) -> LoadedState:
        return self.point.state if self.hand is None else self.hand.state

    def opened(self) -> dict[str, Any]:
        beam, known = self.stored.beam, self.stored.uncertain
        return {
            **{name: getattr(self, name) for name in ("model", "push_s", "point_s", "mode", "version")},
            "length_m": beam.length,
            "rest_m": self._line(self.pushed.start.q).tolist(),
            "places": PLACES.tolist(),
            "max_force_N": self.max_force,
            "largest_first_N": self.largest_first,
            "doubts": [] if known is None else list(known.doubts),
            "band": known is not None,
        }

    def change(self, wanted: Asked) -> None:
        """Changes places, bound or mode. Raises `StudioError` for invalid ones."""
        mode: Mode = "point" if wanted.get("rest") is True else wanted.get("mode", self.mode)
        if mode not in ("point", "hand"):
            raise StudioError("a beam is bent at a point or by a hand")
        push_s, point_s = (wanted.number(name, (1e-6, 1.0, getattr(self, name))) for name in ("push_s", "point_s"))
        max_force = wanted.number("max_force_N", (1e-9, 1e6, self.max_force))
        if mode == "hand":
            push_s = point_s = 1.0
        same = (push_s, point_s, max_force) == (self.push_s, self.point_s, self.max_force)
        before = self.pushed.start if wanted.get("rest") is True else self.state
        if same and mode == self.mode and before is self.state:
            return
        moved = push_s != self.push_s
        self.push_s, self.point_s, self.max_force, self.mode = push_s, point_s, max_force, mode
        self.version += 1
        kept = self.point.map if same else None
        self._renew(None if moved else before)
        self.point.map = kept
        if mode == "hand":
            self.hand = HeldEnd(self.pushed, self.point.state, max_force)

    def take_map(self, version: int, found: ReachMap) -> bool:
        """Accepts a map of the present settings."""
        if version == self.version:
            self.point.map = found
        return version == self.version

    def drag(self, goal: list[float]) -> dict[str, Any]:
        """The beam with its point or end as near to a goal as possible."""
        began = time.perf_counter()
        if not 2 <= len(goal) <= 3 or not all(math.isfinite(one) for one in goal):
            raise StudioError("a goal is (x, y) in m, for a hand with its angle in rad")
        if self.hand is not None:
            angle = goal[2] if len(goal) == 3 else float(self.pushed.pose(self.hand.state.q)[2])
            answer = self.hand.to((goal[0], goal[1], angle))
        else:
            answer = self.point.to(goal[:2])
        return self.shown(answer, began)

    def still(self) -> dict[str, Any]:
        began = time.perf_counter()
        pose = self.pushed.pose(self.state.q)
        answer = self.point.answer(pose[:2]) if self.hand is None else self.hand.answer(pose)
        return self.shown(answer, began)

    def shown(self, answer: DragAnswer, began: float) -> dict[str, Any]:
        state, pose, known = answer.state, answer.pose, self.stored.uncertain
        force = self._shown(state)
        return {
            "goal_m": answer.goal[:2].tolist(),
            "pose": pose.tolist(),
            "force_N": force.tolist(),
            "beyond_learned": 0.0 if self.learned.setup is None else self.learned.setup.beyond(force),
            "moment_N_m": float(state.load[2]),
            "push_m": self._at(state.q, self.push_s).tolist(),
            "line_m": np.round(self._line(state.q), 6).tolist(),
            "ellipse": None if known is None or self.hand is not None else ellipse_of(self.pushed, known, state),
            "limit": answer.limit,
            "turned_away_rad": float(pose[2] - answer.goal[2]) if len(answer.goal) == 3 else 0.0,
            "away_m": float(np.hypot(*(pose[:2] - answer.goal[:2]))),
            "margin": answer.margin,
            "bend_per_m": self.pushed.bend(state.q),
            "command": self._command(pose.tolist()),
            "seconds": time.perf_counter() - began,
            "version": self.version,
        }

    def _command(self, pose: list[float]) -> str:
        """The equivalent command; empty where there is none, as along a straight beam."""
        size = float(np.hypot(*self.state.load[:2]))
        if size == 0.0 and self.state.load[2] == 0.0:
            return ""
        if self.hand is not None:
            goal, angle = [rounded(one, MOST_DIGITS) for one in pose[:2]], math.degrees(pose[2])
            return line("reach", self.model, goal=goal, goal_angle_deg=rounded(angle, MOST_DIGITS - 2), moment=True)
        yields = float(np.linalg.svd(self.pushed.response(self.state)[:2, :2], compute_uv=False)[-1])
        finest = max(_SAME_SHARE * size, _SAME_FORCE) * yields  # m: allowed error of the goal
        if not finest >= _SAME_PLACE:
            return ""
        digits = max(math.ceil(-math.log10(0.1 * finest)), 6)
        goal, at = [rounded(one, digits) for one in pose[:2]], places_of(self.push_s, self.point_s)
        return line("reach", self.model, goal=goal, **at, max_force_N=self.max_force)

    def _renew(self, state: LoadedState | None) -> None:
        self.hand, self.setup, self.stored = None, None, self.learned
        if self.learned.setup is not None and self.learned.uncertain is not None and self.mode == "point":
            self.stored, self.setup = self.learned.bending(self.learned.setup, self.push_s, self.point_s)
        self.beam = json.dumps(self.stored.beam.as_dict(), sort_keys=True)
        self.point = DraggedPoint(pushed_beam(self.beam, self.push_s, self.point_s), self.max_force)
        self._rows = float(self.pushed.problem.length) * self.pushed.problem.grid.integral_to(PLACES)
        if state is not None and len(state.q) == self.pushed.count:
            size = math.hypot(state.load[0], state.load[1])
            self.point.under(state.load[:2] * min(1.0, self.max_force / max(size, 1e-300)))

    def _shown(self, state: LoadedState) -> Array:
        """(2,) N, as the sensor of the set-up shows the force."""
        if self.setup is None:
            return state.load[:2]
        here, rest = (self._at(q, self.push_s) for q in (state.q, self.pushed.start.q))
        shown = self.setup.logged(state.load[None, :2], (here - rest)[None] / float(self.pushed.problem.length))
        return np.asarray(shown[0])

    def _line(self, q: Array) -> Array:
        alpha = self.pushed.angles(q)
        return np.asarray(self._rows @ np.stack([np.cos(alpha), np.sin(alpha)], axis=1))

    def _at(self, q: Array, s: float) -> Array:
        return np.array([np.interp(s, PLACES, row) for row in self._line(q).T])


def bending_of(model: str, folder: Path) -> Bending:
    """From a results folder. Raises `ResultsError`, or `ControlError` if it cannot be bent."""
    stored = read_model(folder)
    force = bending_force(stored.beam)
    one = Bending(model, stored, stored, "", float(f"{LARGEST_TIMES * force:.2g}"))
    one.point.under((0.0, 0.5 * BEGIN_TURN * force))
    return one


# The edge of the reachable set as it is drawn. Its triangles lie in sheets, one over the other and folded, so that the
# ends of one sheet may lie in the midst of another: the edge is taken from a picture of what they cover together.

PIXELS = 1500  # across the picture
_ROOM = 4  # pixels around it
_SMOOTH, _EACH = 9, 3  # steps along the edge that are averaged, and from point to point
_SHORTEST = 60  # steps: a smaller hole is none
_BY_FORCE = 4.0  # pixels: nearer to where the largest force ends a sheet, it is that which ends the whole
_SHORT_RUN = 8  # points: shorter, what limits the beam is that of the points around


def outline_of(found: ReachMap) -> dict[str, Any]:
    """Edge and triangles of the map."""
    lines = [{"limit": limit, "line_m": np.round(line, 6).tolist()} for line, limit in edge_lines(found)]
    points = np.round(np.nan_to_num(found.points), 6)  # points without a shape are in no triangle
    return {"edges": lines, "points_m": points.tolist(), "triangles": found.triangles.tolist()}


def edge_lines(found: ReachMap) -> list[tuple[Array, Edge]]:
    """Lines (P, 2) m around the union of the triangles, each with its limit."""
    corners = found.points[found.triangles]
    low = corners.min(axis=(0, 1))
    pixel = float(np.max(corners.max(axis=(0, 1)) - low)) / PIXELS
    bounds = found.points[found.edges[found.edge_is_force]]
    ends = [np.linspace(one, other, 2 + int(np.linalg.norm(other - one) / pixel)) for one, other in bounds]
    by_force = cKDTree(np.concatenate([np.full((1, 2), np.inf), *ends])[1:]) if ends else None
    lines: list[tuple[Array, Edge]] = []
    for loop in _loops(_painted((corners - low) / pixel + _ROOM)):
        places = low + pixel * (loop - _ROOM)
        away = np.full(len(places), np.inf) if by_force is None else by_force.query(places)[0]
        lines += _runs(places, away < _BY_FORCE * pixel)
    return lines


def _painted(corners: Array) -> BoolArray:
    """(Y, X), the pixels under triangles (T, 3, 2) px."""
    width, height = (np.ceil(corners.max(axis=(0, 1))).astype(int) + _ROOM + 1).tolist()
    picture = Image.new("L", (width, height))
    pen = ImageDraw.Draw(picture)
    for one in corners.reshape(-1, 6).tolist():
        pen.polygon(one, fill=1)
    return np.asarray(picture, dtype=bool)


def _loops(picture: BoolArray) -> list[Array]:
    """Smoothed closed lines (P, 2) px around the covered regions and their holes; the last point is the first."""
    lines = contour_generator(z=picture.astype(float)).lines(0.5)
    loops = [line[:-1] for line in lines if len(line) > _SHORTEST]
    smooth = (uniform_filter1d(loop, _SMOOTH, axis=0, mode="wrap")[::_EACH] for loop in loops)
    return [np.concatenate([loop, loop[:1]]) for loop in smooth]


def _runs(places: Array, forced: BoolArray) -> list[tuple[Array, Edge]]:
    """Parts of a closed line by limit."""
    same = median_filter(forced.astype(np.int8), 2 * _SHORT_RUN + 1, mode="wrap").astype(bool)
    changes = np.flatnonzero(np.diff(same)) + 1
    if len(changes):  # begin at a change, so that no run is cut in two
        same, places = (np.concatenate([one[changes[0] : -1], one[: changes[0] + 1]]) for one in (same, places))
        changes = np.flatnonzero(np.diff(same)) + 1
    parts = [0, *changes.tolist(), len(places) - 1]
    return [
        (places[first : last + 1], "force" if same[first] else "stability")
        for first, last in itertools.pairwise(parts)
        if last > first
    ]
