"""Self-contained pages: a template, the common frame and style, and figures as data."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup, escape

COMMON = "onebend.report.page"


def render(
    package: str, name: str, figures: Mapping[str, bytes], content: Mapping[str, Any], *, scripts: Sequence[str] = ()
) -> str:
    """The template `name` of `package` as HTML; it sees `look` (CSS), `figures` (base64 PNGs by name) and `content`.

    It may extend base.html and take macros from parts.html, which stand in this folder.

    Args:
        scripts: of this folder, run one after the other with `content["data"]` (JSON) beside them. The page allows
            these and no other, and nothing from anywhere else.
    """

    look = Markup(page_file(COMMON, "look.css"))
    encoded = {key: base64.b64encode(png).decode("ascii") for key, png in figures.items()}
    script = Markup("\n".join(page_file(COMMON, file) for file in scripts))
    given = {"look": look, "figures": encoded, "script": script, "policy": _policy(script)}
    return _environment(package, name).get_template(name).render(**given, **content)


@cache
def _environment(package: str, name: str) -> Environment:
    """For the template `name` of `package`; templates are compiled once."""

    def source(file: str) -> str:
        return page_file(package if file == name else COMMON, file)

    environment = Environment(
        loader=FunctionLoader(source), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters["code"] = code_in
    return environment


def code_in(text: str) -> Markup:
    """The text, escaped; what stands between backticks as code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def _policy(script: str) -> str:
    """The page's Content-Security-Policy: its own style, pictures inside it, and the script with this very text."""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    allowed = f"'sha256-{digest}'" if script else "'none'"
    return f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src {allowed}"


def page_file(package: str, file: str) -> str:
    """The text of a template, style or script."""
    return files(package).joinpath(file).read_text(encoding="utf-8")
