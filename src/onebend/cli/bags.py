"""The command that looks into a robot's log."""

from __future__ import annotations

import dataclasses

import typer
from rich.console import Console

from onebend.cli.common import clean_errors, print_json
from onebend.recording.bag_topics import BagContents, bag_contents
from onebend.terminal.bags import show_bag
from onebend.terminal.options import Json
from onebend.terminal.options_bags import BagPath, Definitions


def topics(bag: BagPath, *, definitions: Definitions = None, as_json: Json = False) -> None:
    """List the topics of a ROS bag, with types, counts, rates and times, and what to write of them."""
    with clean_errors():
        found = bag_contents(bag, definitions)
    if as_json:
        print_json(as_data(found))
    else:
        show_bag(Console(), found)
        typer.echo(lines_to_write(found))


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
    tables = []
    for table, topic in (("video", found.image), ("force", found.force)):
        if topic:
            keep = '\ndamaged = "keep"' if found.fault else ""
            tables.append(f'[{table}]\nfile = "{found.path.name}"\ntopic = "{topic}"{keep}')
    if not tables:
        return "It holds no topic of a force or of images that is known. Name a field with field in [force]."
    return "\n\n".join(["For recording.toml:", *tables])
