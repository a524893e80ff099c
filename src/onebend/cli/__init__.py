"""The command line. Results go to standard output, progress and errors to standard error.

Exit codes: 0 done; 2 unusable input or request, or a fault of onebend; 130 interrupted. Commands are listed in
`commands.toml` files, their options in `options.json` (from `make docs`): `--version` and every `--help` load none.
"""

from __future__ import annotations

import gc
import json
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextvars import ContextVar
from difflib import get_close_matches
from functools import wraps
from inspect import Parameter, Signature
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, Union

import typer
from typer.core import TyperCommand, TyperGroup

import onebend
from onebend.crash import clean_errors, guarded
from onebend.progress import one_blas_thread
from onebend.wings import GROUPS, WINGS, Place, commands_of

NAME = "onebend"
MOST_NEW = 100_000  # objects between garbage collections, which otherwise take a 20th of the time
HELP = ("-h", "--help")
OPTIONS = Path(__file__).parent / "options.json"
UsageError: Any = typer.BadParameter.__mro__[1]  # of every wrong option; it has no public name


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
    items = [item for folder in ("cli", *WINGS) for item in commands_of(folder).items()]
    return dict(sorted(items, key=lambda item: GROUPS.index(item[1].group)))


# The options of a command from data: name, kind, default and help of each. `make docs` writes them.

KINDS: dict[str, Any] = {"bool": bool, "int": int, "float": float, "str": str, "Path": Path, "None": None}
MADE_OF: dict[str, Any] = {"tuple": tuple, "list": list, "one of": Literal, "either": Union}
SAID = ("help", "metavar", "min", "max")


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
        """With one BLAS thread; a user's mistake ends it in one message."""
        return self._made(clean_errors()(one_blas_thread(remembered(self.function()))))

    def given(self, words: Sequence[str]) -> dict[str, Any]:
        """What the function is given for these words, which are then in `GIVEN`. Raises `UsageError`."""
        found: dict[str, Any] = {}
        keep = wraps(self.place.load())(lambda **given: found.update(given))
        self._made(remembered(self.function(keep))).main([*words], standalone_mode=False)
        return found

    def described(self) -> Any:
        """For `--help` only, from `options.json`; None if the command is not there."""
        parameters = json.loads(OPTIONS.read_text(encoding="utf-8")).get(self.name)
        return None if parameters is None else self._made(function_of(parameters))

    def _made(self, function: Callable[..., None]) -> Any:
        single = typer.Typer(add_completion=False)
        lines = filter(None, ("Example:", self.place.first, f"{NAME} {self.name} {self.place.example}".strip()))
        single.command(self.name, help=self.place.help, epilog="\n\n".join(lines))(function)
        return typer.main.get_command(single)

    def function(self, function: Callable[..., None] | None = None) -> Callable[..., None]:
        """With a parameter for each option; another `function` may take its place."""
        from onebend.options import expanded  # here: `--help` does without

        return expanded(function or self.place.load(), str(self.name))

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
    text, named = wrong.message.replace("Value error, ", ""), getattr(wrong, "option_name", "")
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
