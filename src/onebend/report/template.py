"""Pages that carry everything in themselves: a template, the common look, and pictures as data."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup


def render(package: str, name: str, figures: Mapping[str, bytes], content: Mapping[str, Any]) -> str:
    """The template `name` of `package` as HTML; it sees `look` (CSS), `figures` (base64 PNGs by name) and `content`."""
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    template = environment.from_string(files(package).joinpath(name).read_text(encoding="utf-8"))
    look = Markup(files("onebend.report").joinpath("look.css").read_text(encoding="utf-8"))
    encoded = {key: base64.b64encode(png).decode("ascii") for key, png in figures.items()}
    return template.render(look=look, figures=encoded, **content)
