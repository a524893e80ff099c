"""Options of the command line, declared on the fields of the settings that they fill.

`option` declares a field's option: its name, default and range stand there alone, and its help in `options.toml`. A
command takes the settings as one parameter, and `expanded` makes an option of each of its fields. An option has the
unit at the end of its name, the field SI units.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cache, wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

POSITIVE, NOT_NEGATIVE = (1e-6, 1e9), (0.0, 1e9)  # ranges; numbers beyond them are no measures of a beam
UNIT = re.compile(r"-(?:(deg|kPa|Hz|mm|ms|Nm|N|m|s|percent)(?:-per-(m|s))?|per-(m|s))$")  # at the end of a name
SCALES = {"deg": math.pi / 180.0, "mm": 1e-3, "ms": 1e-3, "kPa": 1e3, "percent": 1e-2}  # in SI, by the name's end


@dataclass(frozen=True)
class Option:
    """An option of a field; its range is in its own unit."""

    name: str  # or names, the first of which is the key of what is given
    help: str | None  # None: in `options.toml`
    metavar: str | None
    within: tuple[float | None, float | None]
    scale: float  # of the option's unit in SI

    def shown(self, default: Any) -> Any:
        """The field's default as the option's: None where it stands for something found later, or is a flag's."""
        if isinstance(default, bool):
            return False
        if isinstance(default, float):
            return round(default / self.scale, 9) if math.isfinite(default) else None
        return None if isinstance(default, tuple) else default

    def value(self, given: Any, default: Any) -> Any:
        """A given option as the field has it. A flag turns its default around."""
        if isinstance(default, bool):
            return default != given
        if isinstance(given, list):
            return tuple(given)
        return given * self.scale if isinstance(given, float) and self.scale != 1.0 else given


@dataclass(frozen=True)
class Only:
    """Beside settings in `Annotated`: the command has options for these fields alone."""

    names: tuple[str, ...]


def option(
    name: str,
    default: Any,
    help: str | None = None,
    *,
    metavar: str | None = None,
    within: tuple[float | None, float | None] = (None, None),
    scale: float | None = None,
) -> Any:
    """A field of settings with an option.

    Args:
        default: of the field, in SI units. The option has none where it is NaN, infinite or None.
        metavar: default: the unit at the end of the name.
        help: default: that of `options.toml`, under the name of the settings' class.
        within: the least and the largest value that may be given, in the option's unit.
        scale: the option's unit in SI; None: by the end of its name.
    """
    size = SCALES.get(name.rsplit("-", 1)[-1], 1.0) if scale is None else scale
    return field(default=default, metadata={"option": Option(name, help, metavar or _unit(name), within, size)})


def _unit(name: str) -> str | None:
    """MM/S of `--max-speed-mm-per-s`; None of a name without a unit."""
    if (found := UNIT.search(name)) is None:
        return None
    unit, per = found[1] or "1", found[2] or found[3]
    return (f"{unit}/{per}" if per else unit).upper()


def expanded(command: Callable[..., None], name: str = "") -> Callable[..., None]:
    """The command with an option for each declared field in place of its parameters that are settings; the others as
    `options.toml` has them under the command's `name`, or of `every` command."""
    kinds = get_type_hints(command, include_extras=True)
    parameters = list(signature(command).parameters.values())
    settings = {one.name: kinds[one.name] for one in parameters if is_dataclass(_bare(kinds[one.name]))}
    flat: list[Parameter] = []
    for one in parameters:
        flat += _parameters(settings[one.name]) if one.name in settings else [_named(one, kinds[one.name], name)]

    @wraps(command)
    def inside(**given: Any) -> None:
        filled = {name: _filled(_bare(kind)(), given) for name, kind in settings.items()}
        command(**filled, **{one.name: given[one.name] for one in parameters if one.name not in settings})

    inside.__signature__ = signature(command).replace(parameters=flat)  # type: ignore[attr-defined]
    inside.__annotations__ = {one.name: one.annotation for one in flat}
    return inside


def _named(one: Parameter, kind: Any, command: str) -> Parameter:
    """An option of a keyword, an argument of another parameter, as `options.toml` has it; what is annotated stays."""
    import typer  # here: a library that only declares options does without

    if get_origin(kind) is Annotated:
        return one.replace(annotation=kind)
    entry: Any = {**helps()["every"], **helps().get(command, {})}.get(one.name, "")
    said = dict(entry) if isinstance(entry, dict) else {"help": entry}
    names = said.pop("name", f"--{one.name.replace('_', '-')}").split()
    info = typer.Option(*names, **said) if one.kind is Parameter.KEYWORD_ONLY else typer.Argument(**said)
    return one.replace(annotation=Annotated[kind, info])


def _bare(kind: Any) -> Any:
    return get_args(kind)[0] if get_origin(kind) is Annotated else kind


def _declared(settings: type) -> Iterator[tuple[str, Any, Any, Option | None]]:
    """Name, type, default and option of each field with an option, or with settings of its own (without)."""
    kinds = get_type_hints(settings)
    for one in fields(settings):
        if "option" in one.metadata or is_dataclass(kinds[one.name]):
            yield one.name, kinds[one.name], one.default, one.metadata.get("option")


def _parameters(settings: Any) -> Iterator[Parameter]:
    import typer  # here: a library that only declares options does without

    only = next((one.names for one in getattr(settings, "__metadata__", ()) if isinstance(one, Only)), None)
    for name, kind, default, said in _declared(_bare(settings)):
        if only is not None and name not in only:
            continue
        if said is None:
            yield from _parameters(kind)
        else:
            shown, (low, high) = said.shown(default), said.within
            kind = list[get_args(kind)[0]] if get_origin(kind) is tuple else kind  # type: ignore[misc]
            help = said.help or helps()[_bare(settings).__name__][said.name]
            info = typer.Option(*said.name.split(), help=help, metavar=said.metavar, min=low, max=high)
            annotation: Any = Annotated[kind | None if shown is None else kind, info]
            yield Parameter(_key(said), Parameter.KEYWORD_ONLY, default=shown, annotation=annotation)


@cache
def helps() -> dict[str, dict[str, Any]]:
    """`options.toml`: the help of each option by the class of its settings, and the options of each command."""
    return tomllib.loads(Path(__file__).with_name("options.toml").read_text(encoding="utf-8"))


def _filled(settings: Any, given: Mapping[str, Any]) -> Any:
    """The settings with what was given."""
    changes = {}
    for name, _, default, said in _declared(type(settings)):
        if said is None:
            changes[name] = _filled(getattr(settings, name), given)
        elif given.get(_key(said)) is not None:
            changes[name] = said.value(given[_key(said)], default)
    return replace(settings, **changes)


def _key(said: Option) -> str:
    return said.name.split()[0].lstrip("-").replace("-", "_")
