"""Learn, as `onebend learn`. It outlives the studio."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from onebend.cli.common import AnswerOptions
from onebend.cli.learning import learn
from onebend.studio.worker import Studio


def work(studio: Studio, *, told: AnswerOptions, **options: Any) -> None:
    """Tells when k(s) is in place; the report may still be drawn then."""
    learn(**options, told=replace(told, listener=studio))
