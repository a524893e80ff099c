"""The command line. Results go to standard output, progress and errors to standard error.

Exit codes: 0 done; 2 the input or the request cannot be used, with one message that says what to do; 130 interrupted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from onebend.cli.common import BY

COMMANDS = {  # name -> file in this folder, and function
    "learn": ("learning", "learn"),
    "validate": ("learning", "validate"),
    "plan": ("learning", "plan"),
    "damp": ("motion", "damp"),
    "reach": ("control", "reach"),
    "shape": ("shaping", "shape"),
    "path": ("shaping", "path"),
    "loop": ("looping", "loop"),
    "new": ("looking", "new"),
    "topics": ("bags", "topics"),
    "check": ("looking", "check"),
    "calibrate": ("calibrating", "calibrate"),
    "show": ("looking", "show"),
    "export": ("exporting", "export_command"),
    "rerun": ("exporting", "rerun_command"),
    "design": ("making", "design"),
    "mould": ("making", "mould"),
    "tags": ("making", "tags"),
    "film": ("filming", "film"),
    "reproduce": ("reproducing", "reproduce"),
    "rehearse": ("rehearsing", "rehearse"),
}


class Shelf(Mapping[str, Any]):
    """The commands by name, each read when it is asked for: meshes, bags and figures are not loaded to check a file."""

    def __getitem__(self, name: str) -> Any:
        module, function = COMMANDS[name]
        single = typer.Typer(add_completion=False)
        single.command(name)(getattr(import_module(f"onebend.cli.{module}"), function))
        return typer.main.get_command(single)

    def __iter__(self) -> Iterator[str]:
        return iter(COMMANDS)

    def __len__(self) -> int:
        return len(COMMANDS)


class OnDemand(TyperGroup):
    """A group whose commands stand on a `Shelf`."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = Shelf()  # type: ignore[assignment]


app = typer.Typer(
    cls=OnDemand,
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


def main() -> None:
    """The entry point of `onebend`."""
    app()
