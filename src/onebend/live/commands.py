"""Commands that begin a recording and look at what is there."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event
from typing import Annotated, Generic, Self, TypeVar

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from onebend import live
from onebend.cli.common import Told, percent, print_json, say, stderr_screen, stopped_by_hand
from onebend.errors import RecordingError
from onebend.live.guidance import STAGES, CaptureSettings, CaptureState
from onebend.options import Only, option
from onebend.recording.folder import FILE_NAME, folder_of

STAGE_NAMES = {stage: "picture" if stage == "exposure" else stage for stage in STAGES}
_BAR = 30  # columns
State = TypeVar("State")


class StateView(Generic[State]):
    """What is shown of a state that changes: on a screen a picture that is renewed, on a pipe a line for each
    thing that is new. A context manager."""

    def __init__(
        self,
        console: Console | None,
        screen: Callable[[State], RenderableType],
        line: Callable[[State], tuple[object, str]],
    ) -> None:
        """`console`: None: nothing is shown. `line`: what must change for a new line, and that line."""
        self._console, self._screen, self._line = console, screen, line
        self._live = None
        if console is not None and console.is_terminal:
            self._live = Live(console=console, refresh_per_second=8, transient=True)
        self._said: object = None

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, state: State) -> None:
        """What is known now."""
        if self._live is not None:
            self._live.update(self._screen(state))
        elif self._console is not None:
            said, line = self._line(state)
            if said != self._said:
                self._said = said
                self._console.print(line, markup=False)


def recording_line(state: CaptureState) -> tuple[object, str]:
    """What is said of a recording on a pipe."""
    advice = "; ".join(state.advice[:2])
    said = state.stage, re.sub(r"\d", "", state.advice[0] if state.advice else "")  # numbers change all the time
    return said, f"{state.seconds:6.1f} s  {STAGE_NAMES[state.stage]}: {advice}"


def recording_screen(state: CaptureState) -> RenderableType:
    """One screen: the stages, what to do, and what is known."""
    order = list(STAGE_NAMES)
    now = order.index(state.stage)
    stages = Text("  ").join(
        Text(f"{'✓' if i < now else '▶' if i == now else '·'} {STAGE_NAMES[name]}", style="bold" if i == now else "dim")
        for i, name in enumerate(order)
    )
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for what, known in recording_rows(state):
        table.add_row(what, known)
    advice = [Text(f"→ {one}", style="bold" if i == 0 else "") for i, one in enumerate(state.advice)]
    keys = Text("Ctrl-C ends it" if now else "Enter begins the film as it is, Ctrl-C ends it", style="dim")
    return Group(stages, Text(""), *advice, Text(""), table, Text(""), keys)


def recording_rows(state: CaptureState) -> list[tuple[str, str]]:
    """What is known, in words."""
    rows = []
    if state.tags:
        sizes = (f"{tag.id}: {tag.side_px:.0f} px" if tag.seen else f"{tag.id}: not seen" for tag in state.tags)
        rows.append(("tags", ", ".join(sizes)))
    if not math.isnan(state.displacement):
        rows.append(("tip", f"{100 * state.displacement:.0f} % of the length; farthest {100 * state.largest:.0f} %"))
    if np.isfinite(state.force).all():
        (x, y), (x0, y0) = state.force, state.tare
        rows.append(("force", f"{x:+.3f}, {y:+.3f} N, less {x0:.3g}, {y0:.3g} N"))
    if not math.isnan(state.half_width):
        wanted = "" if math.isnan(state.until) else f", wanted ± {100 * state.until:.2g} %"
        bar = "█" * max(1, round(_BAR * min(state.half_width, 1.0)))
        why = f"\n{state.wider}" if state.wider else ""
        rows.append(("k(s)", f"± {100 * state.half_width:.2g} % (95 %, median){wanted}\n{bar:░<{_BAR}}{why}"))
    elif state.live is not None:
        rows.append(("k(s)", state.live.verdict.headline))
    if state.frames:
        missing = f", {state.drops} missing" if state.drops else ""
        rows.append(("film", f"{state.seconds:.1f} s, {state.frames} frames{missing}, {state.bytes / 1e6:.1f} MB"))
    if state.samples:
        missing = f", {state.lost_samples} missing" if state.lost_samples else ""
        clock = "" if math.isnan(state.clock_sd) else f"; clocks to {1e3 * state.clock_sd:.1f} ms"
        rows.append(("log", f"{state.samples} samples{missing}{clock}"))
    if not math.isnan(state.disk_left):
        rows.append(("disk", f"{state.disk_left / 1e9:.1f} GB left"))
    return rows


@dataclass(frozen=True)
class RecordOptions:
    """Which camera and sensor record, or what is played in their place."""

    camera: str | None = option("--camera", None, metavar="SPEC")
    force: str | None = option("--force", None, metavar="SPEC")
    play: Path | None = option("--play", None, metavar="REC")
    like: Path | None = option("--like", None, metavar="REC")
    until: str | None = option("--until", None, metavar="PERCENT")
    fast: bool = option("--fast", False)


Capture = Annotated[CaptureSettings, Only(("begin_at_once", "follow", "longest", "crf", "overwrite"))]


def record(
    folder: Path,
    *,
    asked: RecordOptions,
    settings: Capture,
    told: Told,
) -> None:
    """Record a push with a camera and a force sensor: guided from rest to rest, with k(s) while it goes on."""
    shown = StateView(None if told.quiet or told.as_json else stderr_screen(), recording_screen, recording_line)
    with stopped_by_hand() as (stop, begin), shown as view:
        outcome = recorded(folder, asked, settings, view.show, stop, begin)
    if outcome.film is None or outcome.fault:
        kept = f"The recording up to then is in {folder}." if outcome.film else "Nothing was recorded."
        if outcome.film is None and not outcome.fault:
            kept += " To film whatever is wrong with the picture, add --now."
        why = outcome.why if outcome.why.endswith(("?", ".")) else f"{outcome.why}."
        raise RecordingError(f"{why} {kept}")
    if told.as_json:
        print_json(live.outcome_data(outcome))
        return
    say(live.outcome_words(outcome))


def recorded(
    folder: Path,
    asked: RecordOptions,
    settings: CaptureSettings,
    watch: Callable[[CaptureState], None],
    stop: Event,
    begin: Event,
) -> live.CaptureOutcome:
    """A push, until it is over or `stop` is set. Raises `OnebendError` where it cannot begin."""
    camera, force, play, like = asked.camera, asked.force, asked.play, asked.like
    settings = replace(settings, until=percent(asked.until))
    if play is not None:
        if not (folder_of(play) / FILE_NAME).is_file():
            raise RecordingError(
                f"--play {play}: this is no recording, it holds no {FILE_NAME}. A film alone is played by --camera "
                "film:FILE, a log by --force log:FILE."
            )
        camera, force = camera or f"film:{play}", force or f"log:{play}"
        like = like if (folder / FILE_NAME).exists() else like or play
    if camera is None:
        raise RecordingError("--camera is missing: /dev/video0, or another of docs/record.md; or --play a recording.")
    sources = live.camera_of(camera), None if force in (None, "none") else live.force_of(force)
    if like is not None:
        live.copy_description(like, folder)
    clock = live.PlayedClock() if asked.fast else None
    return live.record(folder, *sources, settings, watch, stop, begin=begin, clock=clock)
