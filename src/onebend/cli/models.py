"""The command that shows a learned beam, and helpers for commands that take one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from numpy.typing import ArrayLike

from onebend.beam.model import Beam
from onebend.beam.problem import has_mass
from onebend.beam.setup import Renewed, SetUp
from onebend.cli import common
from onebend.errors import ControlError
from onebend.options import option
from onebend.records import Array
from onebend.report.sentences import significant
from onebend.results.model import StoredModel, model_file, model_summary, read_model

HEAVY = 100.0  # m/s^2: more is another unit


def show(model: Path, *, told: common.Said) -> None:
    # here: other commands do without
    from onebend.cli.screens import show_model

    stored = read_model(model)
    say_changed(model, stored)
    common.answer(told, model_summary(stored), lambda console: show_model(console, stored))


def read_trusted(model: Path) -> StoredModel:
    """Warns if its k(s) is in doubt."""
    stored = read_model(model)
    say_changed(model, stored)
    doubts = () if stored.uncertain is None else stored.uncertain.doubts
    if doubts:
        common.say_warning(f"k(s) of {model} is NOT TO BE TRUSTED: {'; '.join(doubts)}.", about="not trusted")
    return stored


def say_changed(model: Path, stored: StoredModel) -> None:
    """Warns of a changed or exchanged file, and of one that is not read whole."""
    for words in filter(None, (stored.changed, stored.swapped, stored.left_out)):
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


@dataclass(frozen=True)
class SetUpOptions:
    """In which set-up the beam is bent."""

    new_tool: bool = option("--new-tool", False)
    new_sensor: bool = option("--new-sensor", False)
    remounted: bool = option("--remounted", False)
    beam_alone: bool = option("--beam-alone", False)

    def of(self, stored: StoredModel) -> SetUp | None:
        """The set-up with its new parts; None for the beam alone, or where the model has none."""
        parts: dict[Renewed, bool] = {"tool": self.new_tool, "sensor": self.new_sensor, "mounting": self.remounted}
        new = [name for name, is_new in parts.items() if is_new]
        if self.beam_alone and new:
            raise ControlError("--beam-alone takes no set-up, so nothing in it can be new: give one or the other")
        if stored.setup is None and new:
            raise ControlError(
                "the model has no set-up, so nothing says what is known of it: learn it again with `onebend learn` "
                "from a push with a force log, or leave --new-tool, --new-sensor and --remounted out"
            )
        return None if self.beam_alone or stored.setup is None else stored.setup.renewed(new)

    def bending(
        self,
        stored: StoredModel,
        push_s: float,
        gravity: tuple[float, float],
        points: ArrayLike,
        tags: ArrayLike = -1,
    ) -> tuple[StoredModel, SetUp | None]:
        """The model with the ideal beam that goes where the learned one goes in this set-up, above all at `points` or
        `tags`, and the set-up; the model as it is where there is none."""
        setup = self.of(stored)
        return (stored, None) if setup is None else stored.bending(setup, push_s, points, tags=tags, gravity=gravity)


def warn_beyond_learned(setup: SetUp | None, forces: Array) -> None:
    """Warn of forces (..., 2) [N] that are far beyond those of the recording."""
    times = 0.0 if setup is None else setup.beyond(forces)
    if times:
        common.say_warning(
            f"The force is up to {significant(times)} times the largest one that the beam was learned from. The answer "
            "holds only if the beam is as elastic there.",
            about="beyond what was learned",
        )
