"""Commands that prepare recordings."""

from __future__ import annotations

import dataclasses
import math
import os
import re
import sys
import tomllib
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import numpy as np
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from onebend.cli import common
from onebend.errors import ObservationError, RecordingError
from onebend.files.publish import headed
from onebend.files.single_file import check_name_free, check_replaceable, write_file
from onebend.recording.bag_topics import FIELDS, BagContents, TopicRow, bag_contents
from onebend.recording.calibration import NAMES, Board, BoardKind, Calibration, calibrate as calibrate_camera
from onebend.recording.folder import empty_values, key_at
from onebend.recording.schema import Place, place_name
from onebend.recording.template import FoundInFiles, Kind, write_template
from onebend.report.sentences import significant
from onebend.text_files import to_json

if TYPE_CHECKING:
    from onebend.report.overview import Overview


def show_bag(console: Console, bag: BagContents) -> None:
    first = min((row.start for row in bag.rows if not math.isnan(row.start)), default=math.nan)
    console.print(f"[bold]{escape(str(bag.path))}[/]{begins(first)}", soft_wrap=True)
    table = Table()
    for name in ("topic", "type"):
        table.add_column(name, overflow="fold", min_width=20)
    for name in ("count", "lost", "Hz", "from, s", "to, s"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in bag.rows:
        table.add_row(*cells(row, first))
    console.print(table)
    bare = [row.topic for row in bag.rows if row.count and row.by == "receipt"]
    if bare:
        console.print(f"Without header stamps, by when they were received: {escape(', '.join(bare))}.")


def begins(first: float) -> str:
    """Time of the first message."""
    if math.isnan(first):
        return ""
    return f", from {datetime.fromtimestamp(first, UTC).strftime('%Y-%m-%d %H:%M:%S')} UTC ({first:.6f} s)"


def cells(row: TopicRow, first: float) -> tuple[str, ...]:
    """A row; times count from `first`."""
    kind = row.type.replace("/msg/", "/")
    if not row.count:
        return escape(row.topic), escape(kind), "0", "", "", "", ""
    rate = "" if math.isnan(row.rate) else significant(row.rate)
    span = (f"{row.start - first:.3f}", f"{row.end - first:.3f}")
    return escape(row.topic), escape(kind), f"{row.count}", f"{row.gaps or ''}", rate, *span


def show_overview(console: Console, overview: Overview) -> None:
    table = Table(title=escape(overview.name), title_justify="left", box=None, show_header=False)
    table.add_column(no_wrap=True, style="dim")
    table.add_column(overflow="fold")
    table.add_row("verdict", Text(overview.verdict, "bold"))
    for what, understood in overview.rows:
        table.add_row(what, escape(understood))
    console.print(table)
    if overview.remarks:
        console.print()
        console.print(common.remarks_list([(overview.name, remark) for remark in overview.remarks]))


PICTURE = "check.png"

BESIDE: dict[Kind, str] = {
    "video": "put the video and the force log beside it",
    "ros": "leave the bag where it is",
    "photo": "put the photo into photos, list it in loads.csv, and points along the body in clicks.csv",
    "photos": "put the photos into photos, list their loads in loads.csv",
    "weights": "fill in poses.csv and loads.csv",
    "mocap": "put the tracks and the force log beside it",
}
# Keys that no bag contains.
TO_ADD = (
    'axes = ["x", "y"]  # the two in the plane of bending, in the order of x and y',
    "rotation_deg = 0.0  # the first of them against the beam, counter-clockwise as the camera sees it",
    'acts_on = "beam"  # or "robot"',
)


def new(
    folder: Path,
    *,
    video: bool = False,
    ros: Path | None = None,
    photo: bool = False,
    photos: bool = False,
    weights: bool = False,
    mocap: bool = False,
    everything: bool = False,
    yes: bool = False,
) -> None:
    asked: dict[Kind, bool] = {
        "video": video, "ros": ros is not None, "photo": photo, "photos": photos, "weights": weights, "mocap": mocap
    }  # fmt: skip
    kinds = [kind for kind, wanted in asked.items() if wanted]
    if len(kinds) > 1:
        names = " and ".join(f"--{kind}" for kind in kinds)
        raise RecordingError(f"{names}: a recording is of one kind. Make a folder of each")
    kind: Kind = kinds[0] if kinds else "video"
    found = FoundInFiles() if ros is None else FoundInFiles(bag_values(ros, folder))
    path = write_template(folder, kind, found, everything=everything)
    if not yes and sys.stdin is not None and sys.stdin.isatty():
        text = path.read_text(encoding="utf-8")
        common.say(f"{path}: Enter leaves a line empty.")
        write_file(path, answered(text, ask), overwrite=True)
    text = path.read_text(encoding="utf-8")
    left = dict.fromkeys(str(place[-1]) for place, _, _ in empty_values(text))
    steps = [f"fill in {', '.join(left)}"] if left else []
    there = all((folder / name).exists() for name in re.findall(r'^file = "(.+?)"', text, re.MULTILINE))
    steps += [] if there and kind in ("video", "mocap") else [BESIDE[kind]]
    common.say(f"Wrote {path}. Next: {'; '.join([*steps, f'onebend check {folder}'])}")


def answered(text: str, ask: Callable[[Place, str], str]) -> str:
    """A template with the values that `ask` gives for its empty keys, by place and meaning; an empty one stays."""
    rows = text.splitlines()
    for place, line, _ in empty_values(text):
        entry = key_at(place)
        if entry is not None and (value := ask(place, f"{entry.says}; such as {entry.example}")):
            rows[line - 1] = rows[line - 1].replace(f"{entry.name} = ", f"{entry.name} = {value}", 1)
    return "\n".join(rows) + "\n"


def ask(place: Place, says: str) -> str:
    """A valid value as TOML, asked for at the terminal until it is one; empty for Enter."""
    entry = key_at(place)
    assert entry is not None
    while answer := str(
        typer.prompt(f"{place_name(place[:-1])} {entry.name} ({says})", default="", show_default=False)
    ):
        for value in (answer, to_json(answer)):  # a word without its quotes is a word
            try:
                entry.check(tomllib.loads(f"value = {value}")["value"])
            except (tomllib.TOMLDecodeError, ValueError) as wrong:
                why = str(wrong)
            else:
                return value
        common.say(f"This must be {why}.")
    return ""


def bag_values(bag: Path, folder: Path) -> dict[str, dict[str, str]]:
    """Values for [video] and [force]: the bag's path from `folder`, and the likeliest topics."""
    found = bag_contents(bag)
    file = quoted(os.path.relpath(found.path.resolve(), folder.resolve()))
    video = {"file": file, "topic": quoted(found.image)}
    return {"video": video, "force": {"file": file, "topic": quoted(found.force), "axes": ""}}


def quoted(text: str) -> str:
    """As TOML; empty if there is none or it cannot be written."""
    written = to_json(text) if text else ""
    return written if written.isprintable() and written.encode("utf-8", "replace").decode() == written else ""


def check(
    recording: Path,
    *,
    output: Path = Path(PICTURE),
    told: common.OwnFiles,
) -> None:
    from onebend.report.overview import SOFTWARE, overview  # here: `new` and `topics` read no films

    check_replaceable(output, SOFTWARE, overwrite=told.overwrite)
    found = overview(recording)
    from onebend.report.figures import check_png  # here: Matplotlib loads slowly

    drawn = check_png(found)
    if drawn is not None:
        write_file(output, drawn, overwrite=True)
    if found.faults and told.as_json:
        raise ObservationError("\n".join(found.faults))
    if told.as_json:
        common.print_json({**found.as_dict(), "picture": None if drawn is None else str(output)})
        return
    show_overview(common.screen(), found)
    if drawn is not None:
        common.say(f"picture {output}")
    if found.faults:
        raise ObservationError("\n".join(found.faults))


def topics(bag: Path, *, told: common.Said) -> None:
    found = bag_contents(bag)
    if told.as_json:
        common.print_json(as_data(found))
    else:
        show_bag(common.screen(), found)
        common.say(lines_to_write(found))


def as_data(found: BagContents) -> dict[str, object]:
    rows = [dataclasses.asdict(row) for row in found.rows]
    others = {name: getattr(found, name) or None for name in ("force", "image")}
    return {"bag": str(found.path), "topics": rows, **others}


def lines_to_write(found: BagContents) -> str:
    """Tables of recording.toml for the likeliest topics."""
    tables = []
    if found.image:
        tables.append(["[video]", f'file = "{found.path.name}"', f'topic = "{found.image}"'])
    if found.force:
        others = [row.topic for row in found.rows if row.type in FIELDS and row.count and row.topic != found.force]
        more = f"  # or {', '.join(others)}" if others else ""
        tables.append(["[force]", f'file = "{found.path.name}"', f'topic = "{found.force}"{more}', *TO_ADD])
    if not tables:
        return "It holds no images, and no topic whose force is known: name the topic and its field in [force]."
    return "\n\n".join(["For recording.toml:", *("\n".join(table) for table in tables)])


def show_calibration(console: Console, calibration: Calibration, out: Path) -> None:
    table = common.listing("The camera", "<", "value", "sd")
    for name, value, sd in zip(NAMES, calibration.values, calibration.sd, strict=True):
        if name != "k3" or value != 0.0:
            unit = " \\[px]" if name in NAMES[:4] else ""
            table.add_row(f"{name}{unit}", f"{value:.2f}" if unit else f"{value:.5f}", f"{sd:.2g}")
    console.print(table)
    console.print(
        f"\n{len(calibration.frames)} views; corners {calibration.error:.3f} px from the model (RMS), worst view "
        f"{calibration.view_error.max():.3f} px; corners in {100 * calibration.coverage:.0f} % of the picture; the "
        f"board turned by up to {np.rad2deg(calibration.turned):.0f} degrees.\n"
    )
    console.print(common.remarks_list([("camera", remark) for remark in calibration.remarks]))
    console.print(f"\nWrote {out}; put it into recording.toml:\n", markup=False, soft_wrap=True)
    typer.echo(calibration.camera_table())


CALIBRATE_FORMAT = "onebend-calibrate-1"


def calibrate(
    video: Path,
    *,
    board: tuple[str, str],
    square: float,
    marker: float | None = None,
    dictionary: str = "5x5_100",
    topic: str = "",
    views: int = 30,
    output: Path = Path("camera.toml"),
    told: common.OwnOutput,
) -> None:
    wanted = _board(board, square, marker, dictionary)
    check_name_free(output, overwrite=told.overwrite)
    with common.progress_of(told) as progress:
        found = calibrate_camera(video, wanted, topic=topic, most_views=views, progress=progress)
    write_file(output, found.camera_table(), overwrite=told.overwrite)
    said = headed(CALIBRATE_FORMAT, video=str(video), topic=topic or None, **found.as_dict())
    common.answer(told, said, lambda console: show_calibration(console, found, output), output)


def _board(board: tuple[str, str], square: float, marker: float | None, dictionary: str) -> Board:
    kind, size = board
    kinds: dict[str, BoardKind] = {one: one for one in get_args(BoardKind)}
    if kind not in kinds:
        raise RecordingError(f"There is no board {kind!r}. Known: {', '.join(kinds)}")
    sides = re.fullmatch(r"(\d{1,3})x(\d{1,3})", size)
    if sides is None:
        raise RecordingError(f"The board's size is written as 9x6, got {size!r}")
    side = float("nan") if marker is None else marker / 1000.0
    return Board(kinds[kind], int(sides[1]), int(sides[2]), square / 1000.0, side, dictionary)
