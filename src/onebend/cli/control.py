"""Commands that bend a learned beam."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from onebend.cli import common
from onebend.cli.models import SetUpOptions, gravity_on, read_trusted, warn_beyond_learned
from onebend.control import loop, loop_simulation, reach_set, trajectory_files
from onebend.control.goals import WITHOUT_SETUP, Between, read_goals, read_targets
from onebend.control.path import FollowedPath, PathSettings, PathSpread, by_force, follow_goals, path_spread
from onebend.control.reach import (
    SURE,
    PredictedError,
    Reach,
    ReachInSetUp,
    ReachSettings,
    predicted_error,
    reach as solve_reach,
    reach_in_setup,
)
from onebend.control.shape import Grip, Pusher, ShapeResult, ShapeSettings, shape as solve_shape
from onebend.errors import ControlError
from onebend.options import POSITIVE, option
from onebend.report.sentences import length_words, significant
from onebend.results import control_files
from onebend.results.model import model_file


def show_reach(
    console: Console, result: Reach | ReachInSetUp, error: PredictedError | None, output: Path | None
) -> None:
    force, bare = result.force, isinstance(result, Reach)
    table = common.facts_table()
    table.add_row(f"force at s = {result.push_s:.3g}", common.force_words(force))
    if np.hypot(*(force - result.on_beam)) > 1e-3 * np.hypot(*force):
        table.add_row("on the beam", f"{common.force_words(result.on_beam)}; the sensor shows the one above")
    if result.settings.moment:
        table.add_row("moment there", f"[bold]{result.moment:.4g} N m[/]")
    x, y = 1e3 * result.reached[:2]
    angle = math.degrees(result.reached[2])
    named = f"point s = {result.point_s:.3g}" if result.tag is None else f"centre of tag {result.tag}"
    table.add_row(named, f"at ({x:.3f}, {y:.3f}) mm, tangent at {angle:.1f} deg")
    why = f"after {result.iterations} iterations" if result.converged else result.reason
    table.add_row("from the goal", f"{length_words(result.error)} in the model, {why}")
    table.add_row("sure to within", _sureness_of_goal(error, "band on k(s)" if bare else "set-up of the recording"))
    table.add_row("way there", f"{len(result.path) - 1} steps from rest, each a stable equilibrium on one branch")
    console.print(table)
    common.say_written(console, output, "path.csv, reach.png, summary.json")


def _sureness_of_goal(error: PredictedError | None, source: str) -> str:
    if error is None:
        return common.NO_BAND
    long, short = error.ellipse(SURE).semi_axes
    ellipse = f"± {length_words(long)} along and ± {length_words(short)} across"
    return f"{ellipse} its {100 * SURE:.0f} % ellipse, from the {source}"


def reach(
    model: Path,
    *,
    goal: tuple[float, float],
    push_at: float = 1.0,
    point: float = 1.0,
    tag: int | None = None,
    goal_angle: float | None = None,
    settings: ReachSettings,
    where: SetUpOptions,
    gravity: tuple[float, float] = (0.0, 0.0),
    told: common.Saved,
) -> None:
    stored = read_trusted(model)
    settings = replace(settings, gravity=gravity_on(stored.beam, gravity))
    wanted = np.array([*goal, *([] if goal_angle is None else [math.radians(goal_angle)])])
    setup, known = where.of(stored), stored.uncertain
    found: Reach | ReachInSetUp
    if setup is None or known is None or settings.moment or settings.method == "paper":
        if tag is not None:
            raise ControlError(f"--tag goes with neither --moment nor --method paper: {WITHOUT_SETUP}")
        found = solve_reach(stored.beam, wanted, push_s=push_at, point_s=point, settings=settings)
        if not found.converged:
            raise ControlError(found.reason)
        error = None if known is None else predicted_error(stored.beam, known, found)
    else:
        found = reach_in_setup(
            stored.beam, known, setup, wanted, push_s=push_at, point_s=point, tag=tag, settings=settings
        )
        error = found.predicted
    warn_beyond_learned(stored.setup, found.force)
    summary = control_files.reach_summary(str(model), found, error)
    if told.output is not None:
        from onebend.report.control_figures import reaching  # here: loads Matplotlib

        tables = partial(control_files.write_reach, result=found)
        figures = {"reach": lambda: reaching(found, error, _within(found))}
        common.save_results(told, summary, tables, figures, [model_file(model)])
    common.answer(told, summary, lambda console: show_reach(console, found, error, told.output))


def _within(found: Reach | ReachInSetUp) -> reach_set.ReachableSet | None:
    """Reachable with forces within the bound; None without a bound."""
    settings = found.settings
    if settings.max_force is None:
        return None
    return reach_set.reachable(
        found.beam,
        push_s=found.push_s,
        point_s=found.point_s,
        max_force=settings.max_force,
        max_curvature=settings.max_curvature,
        gravity=settings.gravity,
    )


def show_shape(console: Console, result: ShapeResult, output: Path | None) -> None:
    table = common.facts_table()
    for pusher, force in zip(result.state.actuators.pushes, result.forces, strict=True):
        table.add_row(f"force at s = {pusher.at_s:.3g}", common.force_words(force))
    if result.wrench is not None:
        x, y, angle = result.pose
        table.add_row("gripper", f"[bold]({1e3 * x:.3f}, {1e3 * y:.3f}) mm at {math.degrees(angle):.2f} deg[/]")
        table.add_row(
            "it puts on the beam", f"({result.wrench[0]:.4g}, {result.wrench[1]:.4g}) N and {result.wrench[2]:.4g} N m"
        )
    table.add_row("from the targets", f"{length_words(result.rms, 3)} rms: {_why(result)}")
    table.add_row("from buckling", f"margin {result.margin:.3f} (1 without loads, 0 where it buckles)")
    table.add_row("sure to within", _sureness_of_shape(result))
    console.print(table)
    for warning in result.warnings:
        console.print(f"[yellow]![/] {escape(warning)}")
    common.say_written(console, output, "shape.csv, targets.csv, shape.png, summary.json")


def _why(result: ShapeResult) -> str:
    if result.limits:
        return f"held back by {escape(', '.join(result.limits))}"
    return "the closest that was found" if result.rms > 1e-9 else "they are met"


def _sureness_of_shape(result: ShapeResult) -> str:
    if result.spread is None:
        return "not known so close to buckling" if "stability" in result.limits else common.NO_BAND
    return f"{length_words(2.0 * result.spread.rms)} (2 sd over the targets' places, from the band on k(s))"


def show_path(console: Console, way: FollowedPath, sure: PathSpread | None, output: Path | None) -> None:
    table = common.facts_table()
    stretch = f", {way.stretch:.2f} times the goals'" if way.stretch > 1.0 + 1e-6 else ""
    table.add_row("samples", f"{len(way.time)} over {way.time[-1]:.3f} s{stretch}")
    for pusher, force in zip(way.actuators.pushes, np.moveaxis(way.forces, 1, 0), strict=True):
        table.add_row(f"force at s = {pusher.at_s:.3g}", f"up to {significant(float(np.max(np.hypot(*force.T))))} N")
    if way.wrench is not None:
        table.add_row("gripper's force", f"up to {significant(float(np.max(np.hypot(*way.wrench[:, :2].T))))} N")
    table.add_row("from the goals", f"at worst {length_words(float(np.max(way.miss)))} rms in the model")
    table.add_row("sure to within", _path_sureness(sure))
    table.add_row(
        "from buckling", f"margin at least {float(np.min(way.margin)):.3f} (1 without loads, 0 where it buckles)"
    )
    console.print(table)
    for warning in way.warnings:
        console.print(f"[yellow]![/] {escape(warning)}")
    common.say_written(console, output, "path.csv, ROS 2 messages (YAML), path.png, summary.json")


def _path_sureness(sure: PathSpread | None) -> str:
    if sure is None:
        return common.NO_BAND
    worst = int(np.argmax(sure.rms))
    most = length_words(2.0 * float(sure.rms[worst]))
    return f"{most} at worst, at {sure.time[worst]:.3g} s (2 sd, from the band on k(s))"


@dataclass(frozen=True)
class Hands:
    """Pushes and grip of a command."""

    grip: bool = option("--grip", False)
    push_at: tuple[float, ...] = option("--push-at", (), metavar="S", within=(common.LEAST, 1.0))
    max_force: float = option("--max-force-N", math.inf, within=POSITIVE)
    max_moment: float = option("--max-moment-N-m", math.inf, metavar="N_M", within=POSITIVE)

    def actuators(self) -> tuple[tuple[Pusher, ...], Grip | None]:
        """Default: a push at the tip, or with a grip none."""
        self.refuse_idle({"--max-moment-N-m": self.max_moment})
        places = self.push_at or (() if self.grip else (1.0,))
        pushes = tuple(Pusher(place, self.max_force) for place in places)
        return pushes, Grip(self.max_force, self.max_moment) if self.grip else None

    def refuse_idle(self, limits: Mapping[str, float]) -> None:
        """Raises `ControlError` for a limit of an absent gripper."""
        for name, limit in limits.items():
            if math.isfinite(limit) and not self.grip:
                raise ControlError(f"{name} limits a gripper, and there is none: add --grip, or leave it out")


FAR = 0.5  # of the length, RMS: a useless shape


def shape(
    model: Path,
    *,
    targets: Path,
    hands: Hands,
    settings: ShapeSettings,
    where: SetUpOptions,
    gravity: tuple[float, float] = (0.0, 0.0),
    told: common.Saved,
) -> None:
    stored = read_trusted(model)
    pushes, holding = hands.actuators()
    learned_from, pull = stored.setup, gravity_on(stored.beam, gravity)
    wanted = read_targets(targets, stored.beam.length, where.of(stored))
    stored, setup = where.bending(stored, pushes[0].at_s if pushes else 1.0, pull, wanted.s, wanted.tag)
    found = solve_shape(
        stored.beam,
        wanted,
        pushes=pushes,
        grip=holding,
        gravity=pull,
        uncertain=stored.uncertain,
        settings=settings,
    )
    found = replace(found, setup=setup)
    if found.rms > FAR * stored.beam.length:
        raise ControlError(
            f"nothing near the targets can be reached: the closest shape is {1e3 * found.rms:.4g} mm rms away from "
            f"them, the beam {1e3 * stored.beam.length:.4g} mm long. Give targets that the beam can reach"
        )
    warn_beyond_learned(learned_from, found.forces)
    summary = control_files.shape_summary(str(model), found)
    if told.output is not None:
        from onebend.report.control_figures import shaping  # here: loads Matplotlib

        tables = partial(control_files.write_shape, result=found)
        figures = {"shape": lambda: shaping(stored.beam, found)}
        common.save_results(told, summary, tables, figures, [model_file(model), targets])
    common.answer(told, summary, lambda console: show_shape(console, found, told.output))


def path(
    model: Path,
    *,
    goals: Path,
    point: float = 1.0,
    tag: int | None = None,
    hands: Hands,
    settings: PathSettings,
    where: SetUpOptions,
    between: Literal["force", "smooth", "monotone", "linear"] | None = None,
    gravity: tuple[float, float] = (0.0, 0.0),
    frame: str = trajectory_files.FRAME,
    told: common.Saved,
) -> None:
    stored = read_trusted(model)
    if not frame or not frame.isprintable():
        raise ControlError(f"--frame {frame!r} is no name of a frame: leave out what cannot be printed")
    limits = settings.limits
    hands.refuse_idle({"--max-speed-m-per-s": limits.speed, "--max-turn-rate-deg-per-s": limits.turning})
    pushes, holding = hands.actuators()
    if not pushes and math.isfinite(limits.force):
        raise ControlError("--max-force-rate-N-per-s limits a push, and there is none: add --push-at, or leave it out")
    weight = gravity_on(stored.beam, gravity)
    by_points: Between = "smooth" if between is None or between == "force" else between
    wanted = read_goals(goals, point_s=point, tag=tag, between=by_points, setup=where.of(stored))
    learned, push_s, most = stored, pushes[0].at_s if pushes else 1.0, hands.max_force
    stored, setup = where.bending(stored, push_s, weight, wanted.targets.s, wanted.targets.tag)
    one, to = holding is None and len(pushes) == 1, wanted.targets
    if between == "force" or (between is None and one and len(to.s) == 1 and not to.turned.any()):
        if not one:
            raise ControlError("--between force is for one push; with a grip or more pushes take smooth")
        known = None if setup is None or learned.uncertain is None else (learned.beam, learned.uncertain, setup)
        wanted = by_force(stored.beam, wanted, push_s=push_s, max_force=most, gravity=weight, learned=known)
    way = follow_goals(stored.beam, wanted, pushes=pushes, grip=holding, gravity=weight, settings=settings)
    way = replace(way, setup=setup)
    warn_beyond_learned(learned.setup, way.forces)
    sure = None if stored.uncertain is None else path_spread(way, stored.uncertain)
    summary = control_files.path_summary(str(model), way, sure)
    if told.output is not None:
        from onebend.report.control_figures import path_figure  # here: loads Matplotlib

        tables = partial(control_files.write_path, way=way, frame=frame)
        figures = {"path": lambda: path_figure(way)}
        common.save_results(told, summary, tables, figures, [model_file(model), goals])
    common.answer(told, summary, lambda console: show_path(console, way, sure, told.output))


def show_loop(
    console: Console,
    control: loop.Controller,
    known: loop.Margins,
    trials: tuple[loop_simulation.LoopTrial, ...],
    output: Path | None,
) -> None:
    table = common.facts_table()
    x, y = control.reference.ends
    table.add_row("feedforward", f"[bold]{significant(math.hypot(x, y))} N[/]: ({x:.4g}, {y:.4g}) N, reached in "
                  f"{control.reference.rise:.2f} s")  # fmt: skip
    table.add_row("gains", f"rate {control.gains.rate:.3g} 1/s, filters at {control.gains.corner:.3g} rad/s")
    later = "no limit found" if math.isinf(known.delay) else f"{1e3 * known.delay:.0f} ms"
    turn = "any" if math.isinf(known.phase) else f"{math.degrees(known.phase):.0f} deg"
    table.add_row("margins", f"gain {known.gain:.2f}, phase {turn}, further delay {later}")
    table.add_row("stable while", f"the true k(s) is above {known.softest:.2f} times the model's")
    console.print(table)
    runs = Table("true k(s)", "steady, mm", "settled to 1 mm, s", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for trial in trials:
        steady = "the beam snapped away" if trial.run is None else f"{1e3 * trial.steady:.2f}"
        settled = trial.settled(loop_simulation.SETTLED)
        runs.add_row(trial_name(trial), steady, "never" if math.isinf(settled) else f"{settled:.1f}")
    console.print()
    console.print(runs)
    common.say_written(console, output, "loop.csv, loop.png, summary.json")


def trial_name(trial: loop_simulation.LoopTrial) -> str:
    """The beam of a simulation."""
    share = 100.0 * abs(trial.beam.factor - 1.0)
    way = "lower" if trial.beam.factor < 1.0 else "higher"
    if trial.beam.drawn:
        return f"drawn, {significant(share)} % {way} on average"
    return "as the model" if trial.beam.factor == 1.0 else f"{share:.0f} % {way}"
