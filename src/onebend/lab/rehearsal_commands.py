"""Commands `loop` and `rehearse`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from onebend.cli import common
from onebend.cli.control import show_loop
from onebend.cli.models import SetUpOptions, gravity_on, read_trusted, warn_beyond_learned
from onebend.control import loop_simulation
from onebend.control.loop import Controller, controller
from onebend.errors import RecordingError
from onebend.lab import rehearsal as rehearsals
from onebend.lab.forecast import Tolerances, known_beam, setup_of
from onebend.lab.random_bench import FilmRequest
from onebend.learning.design import PLACES
from onebend.options import POSITIVE, Only, option
from onebend.progress import Progress, Silent, track
from onebend.report.pictures import draw
from onebend.report.sentences import say, significant, width_words
from onebend.results.control_files import loop_summary, write_loop
from onebend.results.model import model_file
from onebend.results.provenance import inputs_of


@dataclass(frozen=True)
class SimulatedLoop:
    """Beams, robot and sensor of a simulated loop."""

    k_error: float = option("--k-error", 0.3, metavar="SHARE", within=(0.0, 0.95))
    draws: int | None = option("--draws", None, metavar="N", within=(1, loop_simulation.MOST_DRAWN))
    max_force: float = option("--max-force-N", math.inf, within=POSITIVE)
    duration: float = option("--duration-s", 8.0, within=(2.0, 600.0))


def loop(
    model: Path,
    *,
    goal: tuple[float, float],
    push_at: float = 1.0,
    point: float = 1.0,
    gravity: tuple[float, float] = (0.0, 0.0),
    camera: loop_simulation.LoopCamera,
    asked: SimulatedLoop,
    where: SetUpOptions,
    told: common.Saved,
) -> None:
    control, simulated = simulation(
        model, goal=goal, push_at=push_at, point=point, gravity=gravity, camera=camera, asked=asked, where=where
    )
    trials, known = tuple(simulated), control.margins()
    summary = loop_summary(str(model), control, known, trials)
    if told.output is not None:
        from onebend.report.control_figures import looping  # here: it loads Matplotlib

        tables, figures = partial(write_loop, trials=trials), {"loop": lambda: looping(control, trials)}
        common.save_results(told, summary, tables, figures, [model_file(model)])
    common.answer(told, summary, lambda console: show_loop(console, control, known, trials, told.output))


def simulation(
    model: Path,
    *,
    goal: tuple[float, float],
    push_at: float,
    point: float,
    gravity: tuple[float, float],
    camera: loop_simulation.LoopCamera,
    asked: SimulatedLoop,
    where: SetUpOptions,
    progress: Progress = Silent(),
) -> tuple[Controller, Iterator[loop_simulation.LoopTrial]]:
    """The controller, and its trials beam by beam as they are simulated."""
    stored = read_trusted(model)
    learned_from, weight = stored.setup, gravity_on(stored.beam, gravity)
    stored, _ = where.bending(stored, push_at, weight, point)
    beam = stored.beam
    beams = (
        loop_simulation.wrong_beams(beam, asked.k_error)
        if asked.draws is None
        else loop_simulation.drawn_beams(beam, stored.uncertain, asked.draws)
    )
    settings = loop_simulation.trial_settings(camera.fps, camera.delay, asked.k_error, asked.max_force)
    control = controller(beam, goal, push_s=push_at, point_s=point, gravity=weight, settings=settings)
    warn_beyond_learned(learned_from, control.reference.ends)
    trials = loop_simulation.simulate_trials(control, beams, eye=camera, duration=asked.duration)
    return control, track(progress, "simulating", trials, len(beams))


EVERY = 10  # of the 101 places


def show_rehearsal(console: Console, rehearsal: rehearsals.Rehearsal) -> None:
    console.print(f"[bold]{escape(rehearsals.setup_words(rehearsal.setup))}[/]")
    console.print(say("would be known", quality=rehearsal.predicted.quality))
    console.print(errors_table(rehearsal))
    console.print()
    if rehearsal.advice:
        console.print(advice_table(rehearsal))
    else:
        console.print("No change helps much.")


def errors_table(rehearsal: rehearsals.Rehearsal) -> Table:
    p = rehearsal.predicted
    title = "Error of k [%]: median, and nine in ten are below"
    title += "" if np.all(p.identified) else " (*: not identified)"
    table = common.listing(title, "s", "k [N m]", "median", "9 in 10")
    for i in range(0, len(PLACES), EVERY):
        place = f"{PLACES[i]:.1f}{' ' if p.identified[i] else '*'}"
        errors = _percent(rehearsals.MEDIAN * p.error[i]), _percent(rehearsals.NINETY * p.error[i])
        table.add_row(place, significant(float(p.k[i])), *errors)
    return table


def advice_table(rehearsal: rehearsals.Rehearsal) -> Table:
    title = "Changes, by how much each narrows the band"
    table = common.listing(title, "", "<change", "k(s) then", "removes")
    for i, change in enumerate(rehearsal.advice, 1):
        table.add_row(str(i), escape(change.text), width_words(change.quality.mean_width), share_words(change.share))
    return table


def share_words(share: float) -> str:
    return f"{100.0 * share:.0f} %" if share >= 0.005 else "-"


def _percent(log_error: float) -> str:
    return f"{100.0 * np.expm1(log_error):.2g}" if log_error < 1.0 else f"x {np.exp(log_error):.2g}"


SHARED = Only(("push", "bend", "seconds", "camera", "fps", "tilt", "distance", "sensor"))  # shared by all pushes


@dataclass(frozen=True)
class RehearseOptions:
    """The pushes and tags of a rehearsal."""

    tags: str | None = option("--tags", None, metavar="S,S,...")
    at: tuple[float, ...] = option("--push-at", (), metavar="S", within=(0.05, 1.0))
    force: tuple[float, ...] = option("--force-N", ())
    direction: tuple[float, ...] = option("--direction-deg", ())
    count: int = option("--count", 8, metavar="N", within=(0, None))


def rehearse(
    design: str,
    *,
    asked: RehearseOptions,
    push: Annotated[FilmRequest, SHARED],
    known_to: Tolerances,
    told: common.AnswerOptions,
) -> None:
    setup = setup_of(
        known_beam(design),
        wishes_of(push, asked.at, asked.force, asked.direction),
        tags=places_of(asked.tags),
        known_to=known_to,
    )
    with (
        common.place_for(told, rehearsals.REHEARSE_FORMAT) as place,
        common.progress_of(told) as progress,
    ):
        inputs = () if place is None else inputs_of([Path(design)])
        found = rehearsals.rehearse(setup, count=asked.count, progress=progress)
        if place is not None:
            pictures = draw({"rehearsal": partial(rehearsals.rehearsal_figure, found)})
            summary = rehearsals.summary_of(found)
            common.put_results(
                place, summary, partial(rehearsals.write_table, rehearsal=found), pictures, inputs=inputs
            )
    if told.as_json:
        common.print_json(rehearsals.summary_of(found))
        return
    show_rehearsal(common.screen(), found)
    if told.output is not None:
        common.say(f"\nWrote {told.output}: rehearsal.png, rehearsal.csv, summary.json.")


def wishes_of(
    first: FilmRequest, at: Sequence[float], force: Sequence[float], direction: Sequence[float]
) -> list[FilmRequest]:
    """One request per push. Raises `RecordingError`: counts do not match, or invalid place or force."""
    given = {"--push-at": at, "--force-N": force, "--direction-deg": direction}
    count = max(1, *map(len, given.values()))
    for name, values in given.items():
        if len(values) not in (0, 1, count):
            raise RecordingError(
                f"{name} is given {len(values)} times for {count} pushes. Give it once, or once a push"
            )

    def pick(values: Sequence[float], i: int) -> float:
        return values[min(i, len(values) - 1)] if values else math.nan

    return [
        replace(first, at_s=pick(at, i), force=pick(force, i), direction=math.radians(pick(direction, i)))
        for i in range(count)
    ]


def places_of(text: str | None) -> tuple[float, ...]:
    """Numbers of `0.33,0.67,1`. Raises `RecordingError`: not a number."""
    if text is None:
        return ()
    try:
        return tuple(float(one) for one in text.split(","))
    except ValueError:
        raise RecordingError(f"--tags {text!r}: write places along the beam such as 0.33,0.67,1") from None
