"""The command that shows a learned beam, and helpers for commands that take one."""

from __future__ import annotations

import math
from pathlib import Path

from onebend.beam.model import Beam
from onebend.beam.problem import has_mass
from onebend.cli import common
from onebend.errors import ControlError
from onebend.results.model import StoredModel, model_file, model_summary, read_model

HEAVY = 100.0  # m/s^2: more is another unit


def show(model: common.Model, *, log: common.LogAxis = False, as_json: common.Json = False) -> None:
    # here: other commands do without
    from onebend.cli.screens import show_model

    with common.clean_errors():
        stored = read_model(model)
        say_changed(model, stored)
    common.answer(as_json, model_summary(stored), lambda console: show_model(console, stored, log=log))


def read_trusted(model: Path) -> StoredModel:
    """Warns if its k(s) is in doubt."""
    stored = read_model(model)
    say_changed(model, stored)
    doubts = () if stored.uncertain is None else stored.uncertain.doubts
    if doubts:
        common.say_warning(f"k(s) of {model} is NOT TO BE TRUSTED: {'; '.join(doubts)}.", about="not trusted")
    return stored


def say_changed(model: Path, stored: StoredModel) -> None:
    """Warns of a changed or exchanged file."""
    for words in filter(None, (stored.changed, stored.swapped)):
        common.say_warning(f"{model_file(model)} {words}.", about="changed file")


def gravity_on(beam: Beam, gravity: tuple[float, float]) -> tuple[float, float]:
    """Gravity [m/s^2] as given. Raises `ControlError` for a model without mass."""
    if not all(math.isfinite(one) for one in gravity):
        raise ControlError(f"gravity is two finite numbers [m/s^2], got {gravity[0]:g} and {gravity[1]:g}")
    if math.hypot(*gravity) > HEAVY:
        raise ControlError(f"gravity of {math.hypot(*gravity):g} m/s^2 is no planet's: is it in m/s^2?")
    if any(gravity) and not has_mass(beam):
        raise ControlError("the model has no mass, so gravity does nothing: learn with mass_kg, or leave gravity out")
    return gravity
