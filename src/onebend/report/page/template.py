"""Self-contained pages: a template, the common frame and style, and figures as data."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

COMMON = "onebend.report.page"


def render(package: str, name: str, figures: Mapping[str, bytes], content: Mapping[str, Any]) -> str:
    """The template `name` of `package` as HTML; it sees `look` (CSS), `figures` (base64 PNGs by name) and `content`.

    It may extend base.html and take macros from parts.html, which stand in this folder.
    """

    def source(file: str) -> str:
        return _text(package if file == name else COMMON, file)

    environment = Environment(
        loader=FunctionLoader(source), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    look = Markup(_text(COMMON, "look.css"))
    encoded = {key: base64.b64encode(png).decode("ascii") for key, png in figures.items()}
    return environment.get_template(name).render(look=look, figures=encoded, **content)


def _text(package: str, file: str) -> str:
    return files(package).joinpath(file).read_text(encoding="utf-8")
