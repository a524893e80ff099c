"""The command line. Results go to standard output, progress and errors to standard error.

Exit codes: 0 done; 2 the input or the request cannot be used, with one message that says what to do; 130 interrupted.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer

from onebend.cli.bags import topics
from onebend.cli.calibrating import calibrate
from onebend.cli.common import BY
from onebend.cli.control import reach
from onebend.cli.exporting import export_command, rerun_command
from onebend.cli.filming import film
from onebend.cli.learning import learn, plan, validate
from onebend.cli.looking import check, new, show
from onebend.cli.looping import loop
from onebend.cli.making import design, mould, tags
from onebend.cli.motion import damp
from onebend.cli.rehearsing import rehearse
from onebend.cli.reproducing import reproduce
from onebend.cli.shaping import path, shape

COMMANDS: dict[str, Callable[..., None]] = {
    "learn": learn,
    "validate": validate,
    "plan": plan,
    "damp": damp,
    "reach": reach,
    "shape": shape,
    "path": path,
    "loop": loop,
    "new": new,
    "topics": topics,
    "check": check,
    "calibrate": calibrate,
    "show": show,
    "export": export_command,
    "rerun": rerun_command,
    "design": design,
    "mould": mould,
    "tags": tags,
    "film": film,
    "reproduce": reproduce,
    "rehearse": rehearse,
}

app = typer.Typer(
    help="Learn how stiff a soft slender object is along its length from one filmed push.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _name, _command in COMMANDS.items():
    app.command(_name)(_command)


def _say_version(asked: bool) -> None:
    if asked:
        typer.echo(BY)
        raise typer.Exit


@app.callback()
def _all_commands(
    *, version: Annotated[bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Say it.")] = False
) -> None:
    pass


def main() -> None:
    """The entry point of `onebend`."""
    app()
