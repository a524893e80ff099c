"""A tool that rubs: a force along the beam that the log does not feel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.learning.allowances import EVERY_ALLOWANCE, rubbing
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import Nuisance, Posterior, fit
from onebend.records import Array, Observations
from tests.learning.allowances.allowed_bench import PUSH_S, course
from tests.learning.bench import SOFT, forces, observed

FRICTION, FRICTION_SD, NOISE = 0.25, 0.3, (2e-5, 1e-3)
S = np.linspace(0.1, 0.9, 9)


def across(force: Array, angle: Array) -> tuple[Array, Array]:
    """(F, 2) N each: the parts of forces across a beam of this angle, and along it."""
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    size = np.sum(force * along, axis=1, keepdims=True)
    return force - size * along, size * along


def rubbed(friction: float) -> Observations:
    """A push whose force along the beam is `friction` times that across it, and a log that feels only the latter."""
    turn, pushed = np.zeros(40), forces(40)
    for _ in range(20):  # the direction of the force follows the shape
        normal, _ = across(forces(40), turn)
        tangent = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        size = normal[:, 1] * tangent[:, 0] - normal[:, 0] * tangent[:, 1]
        pushed = normal + friction * size[:, None] * tangent
        turn = SOFT.equilibrium(pushed, at_s=PUSH_S).angle(np.array([PUSH_S]))[:, 0]
    made = observed(SOFT, pushed, at_s=PUSH_S, noise=NOISE, seed=2)
    return replace(made, force=normal, stated=replace(made.stated, friction_sd=FRICTION_SD))


def fitted(made: Observations, *without: str) -> Posterior:
    return fit([made], 0.03, settings=FitSettings(functions=12, allowances=EVERY_ALLOWANCE - set(without)))


def friction_in(found: Posterior) -> Nuisance:
    return next(n for n in found.nuisances() if n.name.endswith("friction of the tool"))


def test_the_force_is_along_the_beam_and_in_proportion_to_that_across_it() -> None:
    push = course()
    one = rubbing(push)
    assert one is not None
    turn, force = push.turn_at_push, push.force
    normal, _ = across(force, turn)
    pushed = one.basis[..., 0]
    np.testing.assert_allclose(np.sum(pushed * normal, axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.hypot(*pushed.T), np.hypot(*normal.T), atol=1e-12)
    assert np.all(pushed[-1] == 0.0)
    assert one.prior_sd.tolist() == [FRICTION_SD]


def test_it_is_found() -> None:
    one = friction_in(fitted(rubbed(FRICTION)))
    assert abs(one.value - FRICTION) < 2.0 * one.sd
    assert one.sd < 0.5 * one.prior_sd


@pytest.mark.slow
def test_a_tool_that_does_not_rub_costs_next_to_nothing() -> None:
    found, without = fitted(rubbed(0.0)), fitted(rubbed(0.0), "rub")
    one = friction_in(found)
    assert abs(one.value) < one.sd
    np.testing.assert_allclose(found.stiffness.log_at(S)[1], without.stiffness.log_at(S)[1], rtol=0.05)


def test_a_log_of_two_axes_measures_friction() -> None:
    assert rubbing(replace(course(), friction_sd=0.0)) is None
