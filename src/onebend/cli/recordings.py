"""Commands that begin a recording and look at what is there."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from onebend.cli.common import clean_errors, print_json, say, screen
from onebend.cli.options import Json, Overwrite, Recording
from onebend.errors import ObservationError, RecordingError
from onebend.files.kept import VARIABLE, users_folder
from onebend.files.single_file import check_name_free, write_file
from onebend.recording.bags.force_topic import FIELDS
from onebend.recording.bags.topics import BagContents, bag_contents
from onebend.recording.template import Kind, write_template
from onebend.strict_json import to_json
from onebend.terminal.recordings import show_bag, show_overview

if TYPE_CHECKING:
    from onebend.report.overview import Overview

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="The folder to make.")]
BagPath = Annotated[Path, typer.Argument(metavar="BAG", help="A .mcap, .db3 or .bag file, or a bag's folder.")]
Picture = Annotated[
    Path,
    typer.Option("--output", "-o", metavar="PNG", help="The picture to draw; one of an earlier check is replaced."),
]
Definitions = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Folder with .msg files, for a bag that does not say what it holds."),
]

PICTURE = "check.png"
SOFTWARE = "onebend check"  # what stands in the picture, so that only such a one is replaced unasked

Clear = Annotated[bool, typer.Option("--clear", help="Drop all that is kept.")]
VideoKind = Annotated[bool, typer.Option("--video", help="A film of the tags and a force log (the default).")]
RosKind = Annotated[
    Path | None, typer.Option("--ros", metavar="BAG", help="A ROS bag with film and force; topics are filled in.")
]
PhotosKind = Annotated[bool, typer.Option("--photos", help="Photos of the tags under known loads.")]
WeightsKind = Annotated[bool, typer.Option("--weights", help="Points measured by hand under hung weights.")]
MocapKind = Annotated[bool, typer.Option("--mocap", help="Tracks of motion capture and a force log.")]
BESIDE: dict[Kind, str] = {
    "video": "put the video and the force log beside it",
    "ros": "leave the bag where it is",
    "photos": "put the photos and loads.csv beside it",
    "weights": "put poses.csv and loads.csv beside it",
    "mocap": "put the tracks and the force log beside it",
}
# What no bag knows.
TO_ADD = (
    'axes = ["x", "y"]  # the two in the plane of bending, in the order of x and y',
    "rotation_deg = 0.0  # the first of them against the beam, counter-clockwise as the camera sees it",
    'acts_on = "beam"  # or "robot"',
)


def new(
    folder: Folder,
    *,
    video: VideoKind = False,
    ros: RosKind = None,
    photos: PhotosKind = False,
    weights: WeightsKind = False,
    mocap: MocapKind = False,
) -> None:
    """Write a recording.toml to fill in."""
    asked: dict[Kind, bool] = {
        "video": video, "ros": ros is not None, "photos": photos, "weights": weights, "mocap": mocap
    }  # fmt: skip
    kinds = [kind for kind, wanted in asked.items() if wanted]
    with clean_errors():
        if len(kinds) > 1:
            names = " and ".join(f"--{kind}" for kind in kinds)
            raise RecordingError(f"{names}: a recording is of one kind. Make a folder of each")
        kind: Kind = kinds[0] if kinds else "video"
        filled = {} if ros is None else bag_values(ros, folder)
        path = write_template(folder, kind, **filled)
    say(f"Wrote {path}. Fill in what is empty, {BESIDE[kind]}, then: onebend check {folder}")


def bag_values(bag: Path, folder: Path) -> dict[str, dict[str, str]]:
    """What a bag tells of [video] and [force]: its place from `folder` on, the likeliest topics; the axes it cannot."""
    found = bag_contents(bag, None)
    file = quoted(os.path.relpath(found.path.resolve(), folder.resolve()))
    video = {"file": file, "topic": quoted(found.image)}
    return {"video": video, "force": {"file": file, "topic": quoted(found.force), "axes": ""}}


def quoted(text: str) -> str:
    """Text as TOML; nothing, to be filled in, where there is none or no file can hold it."""
    written = to_json(text) if text else ""
    return written if written.isprintable() and written.encode("utf-8", "replace").decode() == written else ""


def check(
    recording: Recording, *, output: Picture = Path(PICTURE), overwrite: Overwrite = False, as_json: Json = False
) -> None:
    """Read a recording's files, look for the tags in some frames, say and draw what was understood."""
    from onebend.report.overview import overview  # here: `new` and `topics` read no films

    with clean_errors():
        check_replaceable(output, overwrite)
        found = overview(recording)
        drawn = draw_check(found)
        if drawn is not None:
            write_file(output, drawn, overwrite=True)
        if found.faults and as_json:
            raise ObservationError("\n".join(found.faults))
    if as_json:
        print_json({**found.as_dict(), "picture": None if drawn is None else str(output)})
        return
    show_overview(screen(), found)
    if drawn is not None:
        say(f"picture {output}")
    if found.faults:
        with clean_errors():
            raise ObservationError("\n".join(found.faults))


def draw_check(found: Overview) -> bytes | None:
    """The picture of a check; None where there is nothing to draw."""
    from onebend.report.figures.checking import check_picture  # here: matplotlib takes a third of a second to load
    from onebend.report.figures.style import png_of

    figure = check_picture(found)
    return None if figure is None else png_of(figure, software=SOFTWARE)


def check_replaceable(path: Path, overwrite: bool) -> None:
    """Raises `ResultsError` where `path` exists and is not a picture that a check drew."""
    if path.is_file() and not overwrite:
        with path.open("rb") as stream:
            if SOFTWARE.encode() in stream.read(200):
                return
    check_name_free(path, overwrite=overwrite)


def topics(bag: BagPath, *, definitions: Definitions = None, as_json: Json = False) -> None:
    """List the topics of a ROS bag, with types, counts, rates and times, and what to write of them."""
    with clean_errors():
        found = bag_contents(bag, definitions)
    if as_json:
        print_json(as_data(found))
    else:
        show_bag(screen(), found)
        say(lines_to_write(found))


def as_data(found: BagContents) -> dict[str, object]:
    """Plain data for `--json`."""
    rows = [dataclasses.asdict(row) for row in found.rows]
    return {
        "bag": str(found.path),
        "topics": rows,
        "force": found.force or None,
        "image": found.image or None,
        "fault": found.fault or None,
    }


def lines_to_write(found: BagContents) -> str:
    """The tables of recording.toml for the likeliest topics."""
    keep = ['damaged = "keep"'] if found.fault else []
    tables = []
    if found.image:
        tables.append(["[video]", f'file = "{found.path.name}"', f'topic = "{found.image}"', *keep])
    if found.force:
        others = [row.topic for row in found.rows if row.type in FIELDS and row.count and row.topic != found.force]
        more = f"  # or {', '.join(others)}" if others else ""
        tables.append(["[force]", f'file = "{found.path.name}"', f'topic = "{found.force}"{more}', *keep, *TO_ADD])
    if not tables:
        return "It holds no images, and no topic whose force is known: name the topic and its field in [force]."
    return "\n\n".join(["For recording.toml:", *("\n".join(table) for table in tables)])


def show_cache(*, clear: Clear = False, as_json: Json = False) -> None:
    """Say which films' tags are kept, so that a film is searched for tags only once; --clear drops them."""
    folder = users_folder()
    with clean_errors():
        kept = [] if folder is None else folder.clear() if clear else folder.entries()
    size = sum(entry.size for entry in kept)
    if as_json:
        where = None if folder is None else str(folder.path)
        print_json({"folder": where, "entries": len(kept), "bytes": size, "cleared": clear})
    elif folder is None:
        say(f"Nothing is kept: {VARIABLE} turns it off, or this system has no place for caches.")
    else:
        films = f"the tags of {len(kept)} {'film' if len(kept) == 1 else 'films'}, {size / 1e6:.3g} MB"
        say(f"{'Dropped' if clear else 'Kept'}: {films}, in {folder.path}")
        if not clear:
            say(f"At most {folder.most / 1e6:.0f} MB are kept; {VARIABLE} names another folder, or turns it off (off).")
