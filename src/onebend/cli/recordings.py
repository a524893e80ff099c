"""Commands that begin a recording and look at what is there."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Annotated

import typer

from onebend.cli.common import clean_errors, percent, print_json, say, screen, stderr_screen, stopped_by_hand
from onebend.cli.options import Json, Overwrite, Quiet, Recording
from onebend.errors import ObservationError, RecordingError
from onebend.files.kept import VARIABLE, users_folder
from onebend.files.single_file import check_replaceable, write_file
from onebend.recording.bags.force_topic import FIELDS
from onebend.recording.bags.topics import BagContents, bag_contents
from onebend.recording.folder import FILE_NAME, folder_of
from onebend.recording.template import Kind, write_template
from onebend.strict_json import to_json
from onebend.terminal.recordings import show_bag, show_overview

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

RecordFolder = Annotated[
    Path, typer.Argument(metavar="DIR", help="A folder with recording.toml (`onebend new DIR`, or --like).")
]
CameraSpec = Annotated[
    str | None, typer.Option("--camera", metavar="SPEC", help="/dev/video0, film:REC (played) ...: docs/record.md.")
]
ForceSpec = Annotated[
    str | None,
    typer.Option(
        "--force",
        metavar="SPEC",
        help="ati:ADDRESS, serial:/dev/ttyUSB0, ur:HOST, log:REC (played) ...; none: film alone.",
    ),
]
Like = Annotated[
    Path | None,
    typer.Option("--like", metavar="REC", help="Another push of this recording's beam: begin with its recording.toml."),
]
Play = Annotated[
    Path | None,
    typer.Option(
        "--play", metavar="REC", help="Play film and log of REC as camera and sensor: to try it without them."
    ),
]
Until = Annotated[
    str | None,
    typer.Option("--until", metavar="PERCENT", help="Push until k(s) is known to ± this; else once."),
]
AtOnce = Annotated[bool, typer.Option("--now", help="Film at once, whatever is wrong with the picture.")]
FilmAlone = Annotated[bool, typer.Option("--no-learning", help="Learn no k(s) meanwhile: for slow computers.")]
Fast = Annotated[bool, typer.Option("--fast", help="What is played comes as fast as it can be read.")]
Longest = Annotated[
    float, typer.Option("--longest-s", min=1.0, max=1e5, metavar="S", help="The film ends then at the latest.")
]
Crf = Annotated[int, typer.Option("--crf", min=0, max=40, metavar="N", help="Of H.264: less is larger and finer.")]
Replace = Annotated[bool, typer.Option("--overwrite", help="Replace film and log of an earlier recording in DIR.")]
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
    from onebend.report.overview import SOFTWARE, overview  # here: `new` and `topics` read no films

    with clean_errors():
        check_replaceable(output, SOFTWARE, overwrite=overwrite)
        found = overview(recording)
        from onebend.report.figures.checking import check_png  # here: matplotlib takes a third of a second to load

        drawn = check_png(found)
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


def record(
    folder: RecordFolder,
    *,
    camera: CameraSpec = None,
    force: ForceSpec = None,
    play: Play = None,
    like: Like = None,
    until: Until = None,
    now: AtOnce = False,
    no_learning: FilmAlone = False,
    fast: Fast = False,
    longest: Longest = 600.0,
    crf: Crf = 18,
    overwrite: Replace = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Record a push with a camera and a force sensor: guided from rest to rest, with k(s) while it goes on."""
    from onebend import capture  # here: `new` and `topics` need no camera
    from onebend.terminal.recordings import RecordingView

    with clean_errors():
        settings = capture.CaptureSettings(
            until=percent(until),
            begin_at_once=now,
            follow=not no_learning,
            longest=longest,
            crf=crf,
            overwrite=overwrite,
        )
        if play is not None:
            if not (folder_of(play) / FILE_NAME).is_file():
                raise RecordingError(
                    f"--play {play}: this is no recording, it holds no {FILE_NAME}. A film alone is played by --camera "
                    "film:FILE, a log by --force log:FILE."
                )
            camera, force = camera or f"film:{play}", force or f"log:{play}"
            like = like if (folder / FILE_NAME).exists() else like or play
        if camera is None:
            raise RecordingError(
                "--camera is missing: /dev/video0, or another of docs/record.md; or --play a recording."
            )
        sources = capture.camera_of(camera), None if force in (None, "none") else capture.force_of(force)
        if like is not None:
            capture.copy_description(like, folder)
        with stopped_by_hand() as (stop, begin), RecordingView(None if quiet or as_json else stderr_screen()) as view:
            clock = capture.PlayedClock() if fast else None
            outcome = capture.record(folder, *sources, settings, view.show, stop, begin=begin, clock=clock)
        if outcome.film is None or outcome.fault:
            kept = f"What was recorded by then is in {folder}." if outcome.film else "Nothing was recorded."
            if outcome.film is None and not outcome.fault:
                kept += " To film whatever is wrong with the picture, add --now."
            raise RecordingError(f"{outcome.why.rstrip('.')}. {kept}")
    if as_json:
        print_json(capture.outcome_data(outcome))
        return
    say(capture.outcome_words(outcome))


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
