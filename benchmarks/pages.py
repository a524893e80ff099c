"""The generated parts of the documentation: `python -m benchmarks.pages` writes them anew, as `make docs` does.

A generated part stands in its page between `<!-- generated: NAME -->` and `<!-- end -->`. docs/cli.md has one
for each command, made from the command's options. docs/recording.md has one for each table of `recording.toml`, made
from the schema. The text around them is written by hand; tests/whole/test_docs.py compares the parts with the code.
`options.json` of the command line is written too; tests/test_startup.py compares it.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, fields
from inspect import Parameter, signature
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from typer.models import OptionInfo

from benchmarks.shown import ROOT, put_block
from onebend.cli import OPTIONS, SAID, Command, all_commands
from onebend.recording.entries import CameraInfoEntry, MassEntry, TagEntry
from onebend.recording.folder import RECORDS
from onebend.recording.schema import Key, keys_of

COMMON = 3  # commands that have an option with the same words, from which on it is explained once
TABLES: dict[str, type] = {
    **RECORDS,
    "beam.masses": MassEntry,
    "tags.on_beam": TagEntry,
    "camera_info": CameraInfoEntry,
}
INHERITED = {"camera_info": "camera"}  # whose common keys are in the other table


def pages() -> dict[Path, dict[str, str]]:
    """The generated parts of every page that has some: name -> Markdown."""
    docs = ROOT / "docs"
    return {
        docs / "cli.md": commands(),
        docs / "recording.md": {name: key_table(name) for name in TABLES},
    }


def renewed(text: str, parts: Mapping[str, str]) -> str:
    """The page `text` with its generated parts as they are now; raises `ValueError` where one has no place."""
    for name, part in parts.items():
        text = put_block(text, f"<!-- generated: {name} -->\n", "<!-- end -->", f"\n{part}\n\n")
    return text


def commands() -> dict[str, str]:
    """The options that several commands share, and each command with its own. An option that two commands share is
    explained at the first of them."""
    parameters = {name: [(one.said, one.says) for one in asked_of(name)] for name in all_commands()}
    counts = Counter(said for own in parameters.values() for said in own)
    shared = [said for said, count in counts.items() if count >= COMMON]
    parts = {"common options": "\n".join(f"- {name}: {says}" for name, says in shared)}
    first = {said: name for name, own in reversed(parameters.items()) for said in own}
    for name, own in parameters.items():
        elsewhere: dict[str, list[str]] = {}
        for said in own:
            if said[0].startswith("`-") and said not in shared and first[said] != name:
                link = f"as for [{first[said]}](#{first[said]})"
                elsewhere.setdefault(link, []).append(said[0].split(",")[0].split(" ")[0].rstrip("`") + "`")
        told = {said for said in own if said in shared or (said[0].startswith("`-") and first[said] != name)}
        lines = [f"- {said}: {says}" for said, says in own if (said, says) not in told]
        lines += [f"- {', '.join(names)}: {link}." for link, names in elsewhere.items()]
        parts[name] = "\n".join([f"    {usage(name)}", "", all_commands()[name].help, "", *lines])
    return parts


def usage(name: str) -> str:
    """How the command is called, with the options that it must have."""
    own = list(asked_of(name))
    words = [one.metavar if one.required else f"[{one.metavar}]" for one in own if not one.names]
    words += [f"{one.names[0]} {one.metavar}" for one in own if one.names and one.required]
    return " ".join(["onebend", name, *words])


@dataclass(frozen=True)
class Asked:
    """An argument (without names) or an option of a command, as its page shows it."""

    names: tuple[str, ...]
    metavar: str  # a placeholder, or the choices
    help: str
    required: bool
    default: Any

    @property
    def said(self) -> str:
        """As it is written on the command line."""
        if not self.names:
            return f"`{self.metavar}`"
        return ", ".join(f"`{one}`" for one in (*self.names[:-1], f"{self.names[-1]} {self.metavar}".strip()))

    @property
    def says(self) -> str:
        """Its help; with it the default, where the help does not say it."""
        unsaid = not self.names or isinstance(self.default, bool) or self.default in (None, "")
        if self.names and self.required:
            return f"{self.help} Required."
        if unsaid or re.search(r"default\b", self.help, re.IGNORECASE):
            return self.help
        return f"{self.help} Default: `{f'{self.default:g}' if isinstance(self.default, float) else self.default}`."


def asked_of(name: str) -> Iterator[Asked]:
    """The arguments and options of a command, in their order."""
    command = Command(name, all_commands()[name])
    hints = get_type_hints(command.function())
    for one in command.loaded().params:
        if one.name not in hints:  # --help
            continue
        kind = hints[one.name]
        choices = [part for each in (kind, *get_args(kind)) if get_origin(each) is Literal for part in get_args(each)]
        yield Asked(
            tuple(sorted(one.opts, key=len)) if one.param_type_name == "option" else (),
            "|".join(choices) or (one.metavar or "").strip("[]"),
            re.sub(r"\s+", " ", one.help or "").strip(),
            one.required,
            one.default,
        )


def key_table(name: str) -> str:
    """The keys of a table of `recording.toml`, in Markdown."""
    without = {key.name for key, _ in _keys(TABLES[INHERITED[name]])} if name in INHERITED else set()
    rows = [(key, value_of(key, default)) for key, default in _keys(TABLES[name]) if key.name not in without]
    return "\n".join(f"- `{key.name}` {value}: {key.says}" for key, value in rows)


def _keys(record: type) -> list[tuple[Key, Any]]:
    """The keys of a record with their defaults; `Ellipsis` for those that must be given."""
    defaults = {one.name: ... if one.default is MISSING else one.default for one in fields(record)}
    return [(key, defaults[name]) for name, (key, _) in keys_of(record).items()]


def value_of(key: Key, default: Any) -> str:
    """The default of a key in the file's own unit; else an example, and whether the key must be given."""
    if default is ...:
        return f"(required, such as `{key.example}`)"
    if default is None or default in ("", ()) or (isinstance(default, float) and not math.isfinite(default)):
        return f"(such as `{key.example}`)"
    return f"(`{as_toml(default, scale_of(key))}`)"


def scale_of(key: Key) -> float:
    """What a number in the file is multiplied by when it is read."""
    example = tomllib.loads(f"x = {key.example}")["x"]
    if isinstance(example, bool) or not isinstance(example, int | float) or example == 0:
        return 1.0
    return float(key.check(example)) / example


def as_toml(value: Any, scale: float = 1.0) -> str:
    """A default as it would be written in the file."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(as_toml(one) for one in value) + "]"
    return f"{value / scale:.3g}" if isinstance(value, int | float) else f'"{value}"'


def options_of(function: Callable[..., None]) -> list[dict[str, Any]]:
    """One entry per parameter of a command: name, kind, default and help."""
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


def options() -> str:
    """The text of `options.json` for `--help`, one row per parameter."""
    found = {name: options_of(Command(name, place).function()) for name, place in all_commands().items()}
    rows = {name: ",\n".join(f"  {json.dumps(one)}" for one in parameters) for name, parameters in found.items()}
    return "{\n" + ",\n".join(f"{json.dumps(name)}: [\n{own}\n]" for name, own in rows.items()) + "\n}\n"


def _from_the_command_line() -> None:
    OPTIONS.write_text(options(), encoding="utf-8")
    for page, parts in pages().items():
        page.write_text(renewed(page.read_text(encoding="utf-8"), parts), encoding="utf-8")
        print(f"{page.relative_to(ROOT)}: {len(parts)} generated parts")


if __name__ == "__main__":
    _from_the_command_line()
