"""The command line. Results go to standard output, progress and errors to standard error.

Exit codes: 0 done; 2 the input or the request cannot be used, with one message that says what to do, or a fault of
onebend itself, with the file that says more; 130 interrupted.
The list of commands stands here as text, so that `--version` and `--help` load no command; each loads what it needs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from functools import wraps
from importlib import import_module
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup

import onebend
from onebend.blas import one_blas_thread
from onebend.crash import guarded

BY = f"onebend {onebend.__version__}"


@dataclass(frozen=True)
class Place:
    """Where a command stands, and the first line of its help."""

    module: str  # in this folder
    function: str
    help: str


COMMANDS = {
    "learn": Place(
        "learning",
        "learn",
        "Learn k(s) with a band from one or several recordings of a beam; results go to OUT (default: REC-results).",
    ),
    "validate": Place(
        "learning",
        "validate",
        "Simulate the learned beam under the forces of other recordings and compare the markers (Tables IV to VI).",
    ),
    "plan": Place("learning", "plan", "Say which push to make next: what each would leave of the band on k(s)."),
    "damp": Place(
        "motion",
        "damp",
        "Learn a learned beam's damping from a recording in which it swings freely, and check k over mass.",
    ),
    "reach": Place(
        "control", "reach", "Find the force that puts a point of a learned beam on a goal (Algorithm 1, Fig. 8)."
    ),
    "shape": Place(
        "shaping",
        "shape",
        "Find the forces, or the gripper's pose, that bring a learned beam closest to a wanted shape.",
    ),
    "path": Place(
        "shaping",
        "path",
        "Turn goals in time into forces, or gripper poses, in time: CSV, ROS 2 messages, a ROS 2 bag.",
    ),
    "loop": Place(
        "looping",
        "loop",
        "Rehearse a closed loop: force for a goal, corrected by a camera, on beams that are not the model.",
    ),
    "new": Place("recordings", "new", "Write a recording.toml to fill in."),
    "topics": Place(
        "recordings",
        "topics",
        "List the topics of a ROS bag, with types, counts, rates and times, and what to write of them.",
    ),
    "check": Place(
        "recordings",
        "check",
        "Read a recording's files, look for the tags in some frames, say and draw what was understood.",
    ),
    "cache": Place(
        "recordings",
        "show_cache",
        "Say which films' tags are kept, so that a film is searched for tags only once; --clear drops them.",
    ),
    "calibrate": Place(
        "calibrating",
        "calibrate",
        "Calibrate the camera from a film of a board, and write the table of the camera for recording.toml.",
    ),
    "show": Place("models", "show", "Draw the learned k(s) in the terminal."),
    "export": Place(
        "exporting",
        "export_command",
        "Write the learned beam for a simulator, a robot's description, a table, or as a function without onebend.",
    ),
    "rerun": Place(
        "exporting",
        "rerun_command",
        "Write a recording and the learned beam as a Rerun file: video, tags, beam, forces, residuals.",
    ),
    "design": Place(
        "making",
        "design",
        "Say what a beam of a design will do on the bench: stiffness, mass, forces, buckling, vibration.",
    ),
    "mould": Place(
        "making",
        "mould",
        "Make the mould of a design, the clamp and the carriers of its tags, as files to print.",
    ),
    "tags": Place("making", "tags", "Draw a sheet of tags at exact size, with rulers to check the printer by."),
    "film": Place(
        "filming",
        "film",
        "Film a known beam that is pushed: a recording folder to learn from, with the truth beside it.",
    ),
    "reproduce": Place(
        "reproducing",
        "reproduce",
        "Make the paper's experiments again: films of three beams, its tables, figures and tasks, in one report.",
    ),
    "rehearse": Place(
        "rehearsing",
        "rehearse",
        "Say how well k(s) would come out of a push before it is filmed, what costs most, and what to change.",
    ),
}


GIVEN: ContextVar[Mapping[str, Any]] = ContextVar("GIVEN")  # options of the command that runs, by name


def remembered(command: Callable[..., None]) -> Callable[..., None]:
    """The command; its options are in `GIVEN` while it runs, for what it writes."""

    @wraps(command)
    def inside(**options: Any) -> None:
        GIVEN.set(options)
        command(**options)

    return inside


class Command(TyperCommand):
    """A name and a line of help; what the command does, and its options, are loaded when it is called."""

    def __init__(self, name: str, place: Place) -> None:
        super().__init__(name, help=place.help)
        self.place = place

    def loaded(self) -> Any:
        """The command itself. It works with one BLAS thread."""
        module = import_module(f"onebend.cli.{self.place.module}")
        single = typer.Typer(add_completion=False)
        single.command(self.name)(one_blas_thread(remembered(getattr(module, self.place.function))))
        return typer.main.get_command(single)

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        return self.loaded().make_context(*args, **kwargs)


class Commands(TyperGroup):
    """The group of all commands, none of them loaded."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = {name: Command(name, place) for name, place in COMMANDS.items()}


app = typer.Typer(
    cls=Commands,
    help="Learn how stiff a soft slender object is along its length from one filmed push.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _say_version(asked: bool) -> None:
    if asked:
        typer.echo(BY)
        raise typer.Exit


@app.callback()
def _all_commands(
    *, version: Annotated[bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Say it.")] = False
) -> None:
    pass


def main() -> NoReturn:
    """The entry point of `onebend`."""
    guarded(app, onebend.__version__)
