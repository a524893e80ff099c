"""What a drive is going to do, within which limits, and what is said of it before anything moves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.problem import has_mass
from onebend.control.goals import read_goals, read_targets
from onebend.control.loop import Controller, ControllerSettings, Gains, RequiredMargins, Timing, controller
from onebend.control.reach import ErrorEllipse, PredictedError, ReachSettings, predicted_error, reach
from onebend.control.shape import Pusher, shape
from onebend.drive.placing import Placement
from onebend.drive.robots import Skill
from onebend.drive.seeing import BentModel
from onebend.errors import ControlError
from onebend.options import option
from onebend.progress import Progress, Silent, one_blas_thread, track
from onebend.recording.beam_frame import RestShape, beam_turn
from onebend.recording.entries import Recording
from onebend.records import Array
from onebend.results.model import StoredModel

ARM = 0.05  # m: a turn of the tool counts as the way of a place so far from its point
QUINTIC = 1.875  # the largest speed of a quintic over its mean one
PATH_PLACES = 33
MORE = 1.2  # times the largest force and bend of the recordings: what is allowed without a word
HARDEST, SLOWEST, FASTEST = 50.0, 1e-4, 0.25  # N, m/s, m/s: no option goes beyond; 0.25 m/s is ISO 10218's hand-guided
MOST_GOALS = 200
TUNED = 4  # goals whose gains are sought; the slowest serve all
HELD = "a held end has a moment that the force log lacks: k(s) is learned from pushes (--hand push)"
LIMIT_UNITS = {"force": "_N", "speed": "_m_per_s", "room": "_m", "margin": "", "curvature": "_per_m"}
Hand = Literal["hold", "push"]


@dataclass(frozen=True)
class DriveLimits:
    """What a drive keeps within, whatever is asked of it. NaN: from the model and its recordings."""

    force: float = option("--max-force-N", math.nan, within=(1e-3, HARDEST))
    speed: float = option("--max-speed-mm-per-s", 0.03, within=(1e3 * SLOWEST, 1e3 * FASTEST), scale=1e-3)
    room: float = option("--room-mm", 0.02, within=(1.0, 200.0))
    margin: float = option("--least-margin", 0.1, metavar="SHARE", within=(0.02, 0.9))
    curvature: float = option("--max-curvature-per-m", math.nan, within=(1e-3, 1e4))
    strain: float = option("--max-strain-percent", 0.3, within=(0.01, 300.0), scale=1e-2)


@dataclass(frozen=True)
class DriveSettings:
    """How a drive is made."""

    hand: Hand = option("--hand", "push")
    by: Skill = option("--by", "pose")
    within: float = option("--within-mm", 3e-4, within=(0.01, 50.0))
    stay: float = option("--stay-s", 1.0, within=(0.0, 3600.0))
    rest: float = option("--rest-s", 3.0, within=(0.5, 60.0))
    longest: float = option("--goal-longest-s", 30.0, within=(2.0, 3600.0))
    k_error: float = option("--k-error", 0.3, metavar="SHARE", within=(0.05, 0.9))
    delay: float = option("--delay-ms", 0.06, within=(0.0, 300.0))
    longest_delay: float = option("--longest-delay-ms", 0.12, within=(10.0, 390.0))
    learn: bool = option("--learn", False)
    limits: DriveLimits = field(default_factory=DriveLimits)
    rate: float = 125.0  # Hz of the commands
    lag: float = 0.02  # s, of the robot, as guessed
    hold: float = 1.0  # s that a fault holds before it is released
    retreat: float = 0.02  # m/s at most, of the way back


@dataclass(frozen=True)
class PlannedGoal:
    """One goal, and the loop that leads there from the goal before."""

    waits: bool  # until it is reached; else the next one begins when its time is over
    control: Controller


@dataclass(frozen=True)
class DrivePlan:
    """All of a drive before it begins."""

    model: StoredModel
    settings: DriveSettings
    limits: DriveLimits  # with every number known
    push_s: float
    point_s: float
    gravity: tuple[float, float]
    goals: tuple[PlannedGoal, ...]
    forces: Array  # (P, 2) N along the whole way
    hand: Array  # (P, 3) m, m, rad: the tool, in the beam's frame
    margin: float  # the smallest on the way
    curvature: float  # 1/m, the largest
    spread: Array  # (2, 2) m^2 of the last goal's point under the planned force alone, by the band of k(s); NaN
    placement: Placement
    remarks: tuple[str, ...] = ()

    @property
    def force(self) -> Array:
        """(2,) N at the last goal, by the model."""
        return self.goals[-1].control.reference.ends

    @property
    def tool_sd(self) -> float:
        """m: how far the tool may end from where it is sent, by what is known of the robot's base."""
        touches = self.hand[0, :2]
        return self.placement.moved_to(self.placement.to_base(touches), touches).sd(self.hand[-1, :2])

    @property
    def open_loop(self) -> ErrorEllipse | None:
        """Where the point would be by the planned force alone (95 %); None where k(s) has no band."""
        if not np.isfinite(self.spread).all():
            return None
        return PredictedError(np.zeros(2), np.zeros(2), self.spread, 0.0).ellipse()

    def force_spread(self) -> Array:
        """(2, 2) N^2: of the force that holds the point on the last goal, by the band of k(s)."""
        inverse = self.goals[-1].control.inverse
        return np.asarray(inverse @ self.spread @ inverse.T)


@one_blas_thread
def make_plan(
    stored: StoredModel,
    rec: Recording,
    goals: Sequence[tuple[float, Array]],
    placement: Placement,
    settings: DriveSettings = DriveSettings(),
    *,
    push_s: float = 1.0,
    point_s: float = 1.0,
    progress: Progress = Silent(),
) -> DrivePlan:
    """The plan for goals (time [s] or NaN, (2,) m), one after the other.

    Raises:
        ControlError: a goal out of reach, or out of a limit; limits that cannot be known.
    """
    _check(rec, settings, push_s)
    limits, gravity = known_limits(stored, rec, settings.limits), gravity_of(rec)
    stored = levelled(stored, rec, gravity)
    beam = stored.beam
    if any(gravity) and not has_mass(beam):
        raise ControlError("recording.toml has gravity in the plane, and the model no mass: learn with mass_kg")
    wanted = RequiredMargins(k_error=settings.k_error)
    timing = Timing(delay=max(settings.delay - settings.lag, 0.0), lag=settings.lag)
    loop = ControllerSettings(
        timing=timing, longest_delay=settings.longest_delay, wanted=wanted, most_force=limits.force
    )
    made, where = list[PlannedGoal](), {"push_s": push_s, "point_s": point_s}
    model = BentModel(beam, push_s, np.array([point_s, push_s]), gravity)
    gains = _gains(beam, goals, push_s, point_s, gravity, loop)
    forces, hand, margin, curvature = [], [], 1.0, 0.0
    start, before = np.zeros(2), 0.0
    for time, goal in track(progress, "Planning", list(goals), len(goals)):
        asked = replace(loop, gains=gains)
        control = controller(beam, goal, **where, gravity=gravity, start=start, settings=asked)
        way = start + np.linspace(0.0, 1.0, PATH_PLACES)[:, None] * (control.reference.ends - start)
        places = []
        for force in way:
            if not model.bend(force):
                raise ControlError(f"on the way to {_mm(goal)} the beam would snap. Give goals between")
            places.append(model.poses()[1])
            margin, curvature = min(margin, model.margin), max(curvature, model.curvature)
        steps = np.abs(np.diff(np.array(places), axis=0))
        turned = ARM * steps[:, 2] if settings.hand == "hold" else np.zeros(len(steps))
        length = float(np.maximum(np.hypot(steps[:, 0], steps[:, 1]), turned).sum())
        rise = max(control.reference.rise, QUINTIC * length / limits.speed, 0.0 if math.isnan(time) else time - before)
        made.append(PlannedGoal(math.isnan(time), replace(control, reference=replace(control.reference, rise=rise))))
        forces.append(way)
        hand.append(np.array(places))
        start, before = control.reference.ends, before if math.isnan(time) else time
    made[-1] = replace(made[-1], waits=True)
    plan = DrivePlan(
        stored, settings, limits, push_s, point_s, gravity, tuple(made), np.concatenate(forces), np.concatenate(hand),
        margin, curvature, _spread(stored, goals[-1][1], push_s, point_s, gravity, limits), placement,
        (HELD,) if settings.hand == "hold" else (),
    )  # fmt: skip
    _within_limits(plan, rec)
    return plan


def _check(rec: Recording, settings: DriveSettings, push_s: float) -> None:
    if rec.camera is None:
        raise ControlError(
            f"{rec.folder}: the camera is not calibrated, and a drive goes by metres. Film a board, run onebend "
            "calibrate, and write its [camera] into recording.toml"
        )
    if rec.force is None or rec.push is None or rec.video is None:
        raise ControlError(f"{rec.folder}: a drive needs [video], [force] and [push] in recording.toml")
    if settings.hand == "hold" and push_s != 1.0:
        raise ControlError("a hand that holds the beam holds its end: take --push-at 1, or --hand push")
    if settings.by == "force" and settings.hand == "hold":
        raise ControlError("a hand that holds the end is led by its pose: take --by pose, or --hand push")
    if settings.hand == "hold" and settings.learn:
        raise ControlError("a held end has a moment that the force log lacks: --learn takes --hand push")
    if settings.longest_delay < settings.delay:
        raise ControlError(
            "--delay-ms is longer than --longest-delay-ms: give a longer one of these, or a faster camera"
        )


def known_limits(stored: StoredModel, rec: Recording, asked: DriveLimits) -> DriveLimits:
    """The limits with every number. Raises `ControlError` where nothing tells one."""
    force, curvature, bench = asked.force, asked.curvature, stored.bench
    if bench is not None:
        pushed = max((one.largest for one in bench.pushes), default=math.nan)
        force = min(MORE * pushed, HARDEST) if math.isnan(force) else force
        curvature = MORE * bench.curvature / bench.length if math.isnan(curvature) else curvature
    thick = next((one for one in (rec.beam.width, rec.beam.diameter, rec.beam.across_flats) if one > 0.0), math.nan)
    if math.isfinite(thick):
        curvature = float(np.fmin(curvature, asked.strain / (0.5 * thick)))
    for name, value in (("--max-force-N", force), ("--max-curvature-per-m", curvature)):
        if not (math.isfinite(value) and value > 0.0):
            raise ControlError(f"nothing tells how far this beam was ever bent: give {name}")
    return replace(asked, force=force, curvature=curvature)


def levelled(stored: StoredModel, rec: Recording, gravity: tuple[float, float]) -> StoredModel:
    """The model in the frame that a picture of the resting beam gives: x along its tags, as `to_beam_frame` takes it.

    A model that is a little bent at rest was learned with a clamp turned the other way; the clamp's turn is each
    recording's own, and not in the model."""
    if any(gravity):
        return stored
    tags = np.array([tag.s for tag in rec.tags.on_beam])
    rest = stored.beam.equilibrium((0.0, 0.0)).xy(tags).reshape(-1, 2)
    shape = RestShape(rest, np.zeros(len(tags)), np.zeros((len(tags), 3, 3)))
    turn = beam_turn(shape, rec.tags.placement_sd)
    return replace(stored, beam=replace(stored.beam, clamp_angle=stored.beam.clamp_angle - turn))


def gravity_of(rec: Recording) -> tuple[float, float]:
    """(2,) m/s^2 in the beam's frame."""
    entry = rec.gravity
    if entry is None:
        return (0.0, 0.0)
    if entry.base_angle_file is not None or math.isnan(entry.base_angle):
        raise ControlError(f"{rec.folder}: a drive needs base_angle_deg in [gravity], and a base that stands still")
    angle = entry.direction - entry.base_angle
    return (entry.magnitude * math.cos(angle), entry.magnitude * math.sin(angle))


def _gains(
    beam: Beam, goals: Sequence[tuple[float, Array]], push_s: float, point_s: float, gravity: tuple[float, float],
    loop: ControllerSettings,
) -> Gains:  # fmt: skip
    """The slowest of those for some of the goals."""
    chosen = np.unique(np.linspace(0, len(goals) - 1, min(TUNED, len(goals))).round().astype(int))
    found = [
        controller(beam, goals[i][1], push_s=push_s, point_s=point_s, gravity=gravity, settings=loop).gains
        for i in chosen.tolist()
    ]
    return min(found, key=lambda one: one.rate)


def _spread(
    stored: StoredModel, goal: Array, push_s: float, point_s: float, gravity: tuple[float, float], limits: DriveLimits
) -> Array:
    if stored.uncertain is None:
        return np.full((2, 2), np.nan)
    bounds = ReachSettings(gravity=gravity, max_force=limits.force)
    found = reach(stored.beam, goal, push_s=push_s, point_s=point_s, settings=bounds)
    return predicted_error(stored.beam, stored.uncertain, found, draws=0).covariance


def _within_limits(plan: DrivePlan, rec: Recording) -> None:
    """Raises `ControlError` where the planned way breaks a limit."""
    limits, most = plan.limits, float(np.max(np.hypot(*plan.forces.T)))
    told = [
        (most > limits.force, f"needs {most:.3g} N", f"{limits.force:.3g} N are allowed (--max-force-N)"),
        (plan.margin < limits.margin, f"leaves a margin of {plan.margin:.2g} from buckling",
         f"{limits.margin:.2g} is the least (--least-margin)"),
        (plan.curvature > limits.curvature, f"bends the beam by {plan.curvature:.3g} 1/m",
         f"{limits.curvature:.3g} 1/m are allowed (--max-curvature-per-m, --max-strain-percent)"),
    ]  # fmt: skip
    for broken, needs, allowed in told:
        if broken:
            raise ControlError(f"{rec.name}: the way to the goal {needs}, and {allowed}")


def read_wanted(
    stored: StoredModel, limits: DriveLimits, *, goal: tuple[float, float] | None, goals: Path | None,
    targets: Path | None, push_s: float, point_s: float, gravity: tuple[float, float],
) -> list[tuple[float, Array]]:  # fmt: skip
    """The goals: a point, a file of points in time, or what one force makes of a wanted shape.

    Raises:
        ControlError: none or several are given, or a file is no goals.
    """
    if sum(one is not None for one in (goal, goals, targets)) != 1:
        raise ControlError("say what to do, once: --goal X Y, --goals FILE, or --shape FILE")
    if goal is not None:
        return [(math.nan, np.asarray(goal, dtype=float))]
    if goals is not None:
        read = read_goals(goals, point_s=point_s)
        if len(read.targets.s) != 1 or read.targets.turned.any() or float(read.targets.s[0]) != point_s:
            raise ControlError(f"{goals}: a drive leads one point (--point), without an angle: time_s, x_m, y_m")
        if len(read.time) > MOST_GOALS:
            raise ControlError(f"{goals} has {len(read.time)} goals, and at most {MOST_GOALS} are driven")
        return [(float(t) - float(read.time[0]), xy[0]) for t, xy in zip(read.time, read.xy, strict=True)]
    assert targets is not None
    aims = read_targets(targets, stored.beam.length)
    found = shape(stored.beam, aims, pushes=[Pusher(push_s, limits.force)], gravity=gravity)
    return [(math.nan, found.xy(point_s)[0])]


def plan_rows(plan: DrivePlan) -> list[tuple[str, str]]:
    """The plan in words: what, and what is said of it."""
    limits, goal = plan.limits, plan.goals[-1].control
    force, sure = plan.force, plan.open_loop
    seconds = sum(one.control.reference.rise for one in plan.goals)
    spread = np.sqrt(np.maximum(np.diag(plan.force_spread()), 0.0))
    band = "" if sure is None else f" ± {2.0 * float(np.linalg.norm(spread)):.2g} N (95 %, by the band of k(s))"
    alone = "" if sure is None else f"; by this force alone to ± {1e3 * float(sure.semi_axes[0]):.2g} mm"
    tool = plan.hand[-1]
    does = "holds the end and turns with it" if plan.settings.hand == "hold" else f"pushes at s = {plan.push_s:.3g}"
    towards = math.degrees(math.atan2(force[1], force[0]))
    several = f", the last of {len(plan.goals)}" if len(plan.goals) > 1 else ""
    return [
        ("goal", f"s = {plan.point_s:.3g} to {_mm(goal.goal)}{several}"),
        ("tool", f"{does}, by {plan.settings.by}; at last at {_mm(tool[:2])}, {math.degrees(tool[2]):.3g} deg"),
        ("force", f"{float(np.hypot(*force)):.3g} N at {towards:.4g} deg{band}{alone}"),
        ("takes", f"{seconds:.3g} s to move, and {2.0 * plan.settings.rest + seconds:.3g} s to rest and come back"),
        ("robot", f"placed by {plan.placement.source}; goes where it is sent to ± {2e3 * plan.tool_sd:.2g} mm (2 sd)"),
        ("limits", f"{limits.force:.3g} N, {1e3 * limits.speed:.3g} mm/s, {1e3 * limits.room:.3g} mm from its way, "
         f"margin {plan.margin:.2g} (least {limits.margin:.2g}), "
         f"bend {plan.curvature:.3g} of {limits.curvature:.3g} 1/m"),
        *[("note", one) for one in plan.remarks],
    ]  # fmt: skip


def plan_data(plan: DrivePlan) -> dict[str, Any]:
    """The same for `to_json`, SI."""
    ellipse, limits = plan.open_loop, plan.limits
    return {
        "goals_m": [one.control.goal.tolist() for one in plan.goals],
        **{"point_s": plan.point_s, "push_s": plan.push_s, "hand": plan.settings.hand, "by": plan.settings.by},
        "force_N": plan.force.tolist(),
        "force_sd_N": np.sqrt(np.maximum(np.diag(plan.force_spread()), 0.0)).tolist(),
        "by_force_alone_m": None if ellipse is None else ellipse.semi_axes.tolist(),
        "tool_m_rad": plan.hand[-1].tolist(),
        "tool_sd_m": plan.tool_sd,
        "placed_by": plan.placement.source,
        "margin": plan.margin,
        "curvature_per_m": plan.curvature,
        "limits": {f"{name}{unit}": getattr(limits, name) for name, unit in LIMIT_UNITS.items()},
    }


def _mm(place: Array) -> str:
    return f"({1e3 * place[0]:.4g}, {1e3 * place[1]:.4g}) mm"
