"""The command line. Results go to standard output, progress and errors to standard error.

Exit codes: 0 done; 2 unusable input or request, or a fault of onebend; 130 interrupted. Commands are listed here as
text, and their options in `options.json` (from `make docs`), so that `--version` and every `--help` load none.
"""

from __future__ import annotations

import gc
import json
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping
from contextvars import ContextVar
from difflib import get_close_matches
from functools import wraps
from importlib import import_module
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, Union, get_args, get_origin

import typer
from typer.core import TyperCommand, TyperGroup
from typer.models import OptionInfo

import onebend
from onebend.crash import guarded
from onebend.progress import one_blas_thread
from onebend.wings import GROUPS, Place, wings

NAME = "onebend"
MOST_NEW = 100_000  # objects between garbage collections, which otherwise take a 20th of the time
HELP = ("-h", "--help")
OPTIONS = Path(__file__).parent / "options.json"
UsageError: Any = typer.BadParameter.__mro__[1]  # of every wrong option; it has no public name


COMMANDS = {
    "learn": Place(
        "onebend.cli.learning:learn",
        "Learn k(s) with a band from one or several recordings of a beam; results go to OUT (default: REC-results).",
        "examples/linear-beam/train -o out/linear-beam --force",
        group="Learn",
    ),
    "validate": Place(
        "onebend.cli.learning:validate",
        "Simulate the learned beam under the forces of other recordings and compare the markers (Tables IV to VI).",
        "out/linear-beam examples/linear-beam/fast",
        group="Learn",
    ),
    "plan": Place(
        "onebend.cli.learning:plan",
        "Rank the next pushes by how much each would narrow the band of k(s).",
        "out/linear-beam --count 3",
        group="Learn",
    ),
    "damp": Place(
        "onebend.cli.learning:damp",
        "Estimate a learned beam's damping from a free swing, and check k over mass.",
        "out/linear-beam out/released",
        "onebend film linear --push free --sensor wrist -o out/released",
        group="Learn",
    ),
    "sense": Place(
        "onebend.cli.learning:sense",
        "Estimate the force on a learned beam from its shape, frame by frame, with a 95 % region.",
        "out/linear-beam examples/linear-beam/fast",
    ),
    "reach": Place(
        "onebend.cli.control:reach",
        "Find the force that puts a point of a learned beam on a goal (Algorithm 1, Fig. 8).",
        "out/linear-beam --goal 0.1338 0.0638",
    ),
    "shape": Place(
        "onebend.cli.control:shape",
        "Find the forces, or the gripper's pose, that bring a learned beam closest to a wanted shape.",
        "out/linear-beam --targets examples/bend/targets.csv --grip",
    ),
    "path": Place(
        "onebend.cli.control:path",
        "Compute the forces or gripper poses that follow goals in time, as CSV and ROS 2 messages.",
        "out/linear-beam --goals examples/bend/goals.csv -o out/path",
    ),
    "new": Place("onebend.cli.recordings:new", "Write a recording.toml to fill in.", "my-beam", group="Measure"),
    "topics": Place(
        "onebend.cli.recordings:topics",
        "List the topics of a ROS bag, and say which to write in recording.toml.",
        "my-beam/push.mcap",
        group="Measure",
    ),
    "check": Place(
        "onebend.cli.recordings:check",
        "Check a recording in seconds: read its files, search some frames for tags, draw the result.",
        "examples/linear-beam/train",
        group="Measure",
    ),
    "calibrate": Place(
        "onebend.cli.recordings:calibrate",
        "Calibrate the camera from a film of a board, and write its table for recording.toml.",
        "board.mp4 --board chessboard 9x6 --square-mm 20",
        group="Measure",
    ),
    "frequencies": Place(
        "onebend.cli.learning:frequencies",
        "Find the natural frequencies in a free swing, for recording.toml.",
        "examples/ruler/swing.csv",
        group="Measure",
    ),
    "show": Place(
        "onebend.cli.models:show", "Draw the learned k(s) in the terminal.", "out/linear-beam", group="Learn"
    ),
    "export": Place(
        "onebend.cli.exporting:export_command",
        "Write the learned beam for a simulator, as a robot description, a table, or a Python file without onebend.",
        "out/linear-beam --to mujoco -o out/beam.xml",
    ),
}


GIVEN: ContextVar[Mapping[str, Any]] = ContextVar("GIVEN")  # options of the running command


def remembered(command: Callable[..., None]) -> Callable[..., None]:
    """The command with its options in `GIVEN`."""

    @wraps(command)
    def inside(**options: Any) -> None:
        GIVEN.set(options)
        command(**options)

    return inside


def all_commands() -> dict[str, Place]:
    """Of the core and the installed wings, by group."""
    brought = [import_module(f"onebend.{wing}").COMMANDS for wing in wings()]
    items = [item for table in (COMMANDS, *brought) for item in table.items()]
    return dict(sorted(items, key=lambda item: GROUPS.index(item[1].group)))


# The options of a command as data: name, kind, default and help of each.

KINDS: dict[str, Any] = {"bool": bool, "int": int, "float": float, "str": str, "Path": Path, "None": None}
MADE_OF: dict[str, Any] = {"tuple": tuple, "list": list, "one of": Literal, "either": Union}
SAID = ("help", "metavar", "min", "max")


def as_data(function: Callable[..., None]) -> list[dict[str, Any]]:
    """One entry per parameter."""
    return [_parameter_data(one) for one in signature(function).parameters.values()]


def _parameter_data(one: Parameter) -> dict[str, Any]:
    kind, info = get_args(one.annotation)
    asked = isinstance(info, OptionInfo)
    names = [name for name in (info.default, *(info.param_decls or ())) if isinstance(name, str)] if asked else None
    said = {key: getattr(info, key) for key in SAID if getattr(info, key) is not None}
    default = {} if one.default is Parameter.empty else {"default": one.default}
    data = {"name": one.name, "kind": _kind_data(kind), "options": names, **said, **default}
    return dict(json.loads(json.dumps(data, default=str)))


def _kind_data(kind: Any) -> Any:
    inside, origin = get_args(kind), get_origin(kind)
    if not inside:
        return kind if isinstance(kind, str) else "None" if kind is type(None) else kind.__name__
    name = {tuple: "tuple", list: "list", Literal: "one of"}.get(origin, "either")
    return [name, *(one if origin is Literal else _kind_data(one) for one in inside)]


def function_of(data: Iterable[Mapping[str, Any]]) -> Callable[..., None]:
    """Does nothing, with these parameters."""

    def nothing(**_: Any) -> None:
        pass

    parameters = [_parameter(one) for one in data]
    nothing.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    nothing.__annotations__ = {one.name: one.annotation for one in parameters}
    return nothing


def _parameter(data: Mapping[str, Any]) -> Parameter:
    said, kind = {key: data[key] for key in SAID if key in data}, _kind(data["kind"])
    info = typer.Argument(**said) if data["options"] is None else typer.Option(*data["options"], **said)
    default = data.get("default", Parameter.empty)
    if isinstance(default, list):
        default = tuple(default)
    return Parameter(data["name"], Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, info])


def _kind(data: Any) -> Any:
    if isinstance(data, str):
        return KINDS[data]
    inside = tuple(data[1:]) if data[0] == "one of" else tuple(map(_kind, data[1:]))
    return MADE_OF[data[0]][inside]


class Command(TyperCommand):
    """A name and a line of help; function and options are loaded on call."""

    def __init__(self, name: str, place: Place) -> None:
        super().__init__(name, help=place.help, rich_help_panel=place.group)
        self.place = place

    def loaded(self) -> Any:
        """With one BLAS thread."""
        return self._made(one_blas_thread(remembered(self.function())))

    def described(self) -> Any:
        """For `--help` only, from `options.json`; None if the command is not there."""
        parameters = json.loads(OPTIONS.read_text(encoding="utf-8")).get(self.name)
        return None if parameters is None else self._made(function_of(parameters))

    def _made(self, function: Callable[..., None]) -> Any:
        single = typer.Typer(add_completion=False)
        lines = filter(None, ("Example:", self.place.first, f"{NAME} {self.name} {self.place.example}".strip()))
        single.command(self.name, help=self.place.help, epilog="\n\n".join(lines))(function)
        return typer.main.get_command(single)

    def function(self) -> Callable[..., None]:
        """With a parameter for each option."""
        from onebend.options import expanded  # here: `--help` does without

        return expanded(self.place.load())

    def make_context(self, info_name: str | None, args: list[str], *more: Any, **kwargs: Any) -> Any:
        if {*HELP} & {*args} and (described := self.described()) is not None:
            described.make_context(
                info_name, list(args), *more, **kwargs
            )  # returns only if `--help` is not an option here
        command = self.loaded()
        try:
            return command.make_context(info_name, args, *more, **kwargs)
        except UsageError as wrong:
            wrong.message = plainer(wrong, command.params)
            raise


def plainer(wrong: Any, params: Iterable[Any]) -> str:
    """The message of a wrong option, with the values that it needs, or the nearest word that it knows."""
    text, named = wrong.message, getattr(wrong, "option_name", "")
    param = getattr(wrong, "param", None) or next((one for one in params if named and named in one.opts), None)
    if param is not None and ("requires" in text or "valid number" in text):
        count = "a number" if param.nargs == 1 else f"{param.nargs} numbers"
        return f"{param.opts[0]} needs {count}: {param.metavar}"
    if match := re.search(r"'([^']*)' is not one of (.*)\.$", text):
        near = get_close_matches(match[1], re.findall(r"'([^']*)'", match[2]), n=1)
        return f"{text} Did you mean {near[0]}?" if near else text
    return str(text)


class Commands(TyperGroup):
    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = {name: Command(name, place) for name, place in all_commands().items()}

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """`onebend help learn` is `onebend learn --help`."""
        return list(super().parse_args(ctx, [*args[1:2], HELP[1]] if args[:1] == ["help"] else args))


app = typer.Typer(
    cls=Commands,
    help="Learn how stiff a soft slender object is along its length from one filmed push.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": [*HELP]},
)


def _say_version(asked: bool) -> None:
    if asked:
        typer.echo(f"{NAME} {onebend.__version__}")
        raise typer.Exit


Version = Annotated[
    bool, typer.Option("--version", "-V", callback=_say_version, is_eager=True, help="Print the version.")
]


@app.callback()
def _all_commands(*, version: Version = False) -> None:
    pass


def main() -> NoReturn:
    """The entry point of `onebend`."""
    gc.set_threshold(MOST_NEW)
    if not sys.warnoptions:  # onebend checks its numbers itself
        os.environ["PYTHONWARNINGS"] = "ignore::RuntimeWarning"  # of child processes
        warnings.simplefilter("ignore", RuntimeWarning)
    guarded(app, onebend.__version__)
