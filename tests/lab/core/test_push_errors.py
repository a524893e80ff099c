"""Place and direction of the push, as unknowns of the fit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from onebend.lab.bench import ForceSensor, PushProfile
from onebend.lab.designs import force_that_bends
from onebend.lab.virtual import DeclaredValues, VirtualBench, VirtualClock, observe_virtual, virtual_recording
from onebend.learning.fit_data import FitData, fit_data
from onebend.learning.parameters import Layout, Spline, make_layout
from onebend.learning.posterior import Posterior, fit
from onebend.learning.prediction import predict
from onebend.learning.verdict import fit_notices
from onebend.records import DIRECTION_SD, PLACE_SD, Array, ClockOffset, Observations
from onebend.report.sentences import worded
from tests.learning.bench import IDEAL, MARKERS, SOFT, forces, observed
from tests.made_up import with_source, with_stated

pytestmark = pytest.mark.usefixtures("no_other_places")

HELD = {"turn_sd": 0.0, "placement_sd": 0.0, "clamp_sd": 0.0}


def prepared(one: Observations) -> tuple[FitData, Layout, Array]:
    """A film, its parameters, and their values at the beam's own k."""
    spline = Spline(48)
    seen = fit_data(one, 0, np.ones(len(one.time), dtype=bool), spline)
    at = make_layout(spline, [one], [len(seen.error.knots)])
    s = np.linspace(0.0, 1.0, 400)
    x = np.zeros(at.size)
    x[: spline.count] = np.linalg.lstsq(spline.basis(s), np.log(SOFT.stiffness(s)), rcond=None)[0]
    return seen, at, x


def poses(force: Array, at_s: float) -> Array:
    shape = SOFT.equilibrium(force, at_s)
    return np.concatenate([shape.xy(MARKERS), shape.angle(MARKERS)[..., None]], axis=-1)


@pytest.mark.parametrize("at_s", [0.5, 0.8, 0.97])
def test_a_push_farther_out_is_a_push_at_another_place(at_s: float) -> None:
    force, out = forces(20), 1e-4
    one = observed(SOFT, force, at_s=at_s)
    seen, at, x = prepared(with_stated(one, **HELD))
    x[at.index["place", 0].where] = out
    moved = predict(seen, at, x, None).pose[: len(force)] - poses(force, at_s)
    exact = poses(force, at_s + out / SOFT.length) - poses(force, at_s)
    assert np.max(np.abs(exact[..., 2])) > 2e-4
    assert np.allclose(moved[..., 2], exact[..., 2], atol=0.01 * np.max(np.abs(exact[..., 2])))
    assert np.allclose(moved[..., :2], exact[..., :2], atol=0.01 * np.max(np.abs(exact[..., :2])))


def test_turned_axes_turn_the_logged_force() -> None:
    force, turn = forces(20), 0.03
    turned = force @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    seen, at, x = prepared(with_stated(observed(SOFT, force), **HELD))
    x[at.index["direction", 0].where] = turn
    np.testing.assert_allclose(predict(seen, at, x, None).force[: len(force)], turned, atol=1e-12)


@pytest.mark.parametrize("name", ["place", "direction", "force", "clock"])
def test_derivatives_are_those_of_the_prediction(name: str) -> None:
    one = replace(observed(SOFT, forces(12), at_s=0.9), time=np.arange(12) / 5.0)
    one = with_source(one, clock=ClockOffset(offset=0.0, sd=0.005, stated=0.0, found=True))
    seen, at, x = prepared(with_stated(one, **(HELD | {"placement_sd": 1e-3})))
    x[at.index["place", 0].where], x[at.index["direction", 0].where] = 2e-3, 0.1
    x[at.index["along", -1].where] = -1e-3
    columns, where, h = at.columns(name, 0), at.index[name, 0].where, 1e-5
    assert columns is not None
    exact = predict(seen, at, x, None).slopes.written[..., columns]
    for i in range(where.stop - where.start):
        step = np.zeros(at.size)
        step[where.start + i] = h
        far, near = (predict(seen, at, x + sign * step, None).pose for sign in (1.0, -1.0))
        change = (far - near) / (2.0 * h)
        np.testing.assert_allclose(exact[..., i], change, atol=1e-4 * np.max(np.abs(change)) + 1e-12)


def learned(
    at_s: float = 1.0,
    said: float = np.nan,
    turn: float = 0.0,
    bend: float = 1.0,
    scale: tuple[float, float] = (1.0, 1.0),
    place_sd: float = PLACE_SD,
    direction_sd: float = DIRECTION_SD,
    start_sd: float = 0.0,
) -> Posterior:
    """A push of known beam, place and axes, through the real way, with the tolerances that are said (Observations)."""
    peak = force_that_bends(SOFT, bend, 1.75) / at_s
    sensor = ForceSensor(white_sd=0.02 * peak, coloured_sd=0.02 * peak)
    bench = VirtualBench(
        beam=SOFT, push=PushProfile(peak, at_s=at_s), sensor=sensor, declared=DeclaredValues(push_s=said),
        clock=VirtualClock(uncertainty=2.0 * start_sd),
    )  # fmt: skip
    made = virtual_recording(bench, seed=1)
    cos, sin = np.cos(turn), np.sin(turn)
    log = replace(made.log, force=made.log.force @ np.array([[cos, sin], [-sin, cos]]) * np.array(scale))
    seen = with_stated(observe_virtual(replace(made, log=log)), place_sd=place_sd, direction_sd=direction_sd)
    return fit([seen], 0.02, settings=replace(IDEAL, functions=16, most_frames=80, first_frames=40))


def found(one: Posterior, name: str) -> tuple[float, float]:
    return next((n.value, n.sd) for n in one.nuisances() if n.name.endswith(name))


@pytest.mark.slow
def test_what_the_push_is_off_by_widens_the_band() -> None:
    s = np.linspace(0.1, 0.9, 9)
    known, free = learned(place_sd=0.0, direction_sd=0.0, start_sd=1.0), learned(start_sd=1.0)
    assert not any(n.name.endswith(("push place", "force axes")) for n in known.nuisances())
    width = [np.log(one.band(s).high / one.band(s).low) for one in (known, free)]
    assert np.all(width[1] > 0.95 * width[0])  # sizes of log k's prior are sampled: a few per cent
    assert np.mean(width[1]) > np.mean(width[0])
    assert width[1][-1] > 1.02 * width[0][-1]
    assert worded(fit_notices(free)) == ()


@pytest.mark.slow
def test_axes_that_are_off_are_found_within_their_tolerance() -> None:
    turn, sd = found(learned(turn=0.15, direction_sd=0.3), "force axes")
    assert sd < 0.05
    assert abs(turn + 0.15) < 3.0 * sd


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("force direction", {"turn": 0.35}),
        pytest.param("push place", {"at_s": 0.6, "said": 1.0}, marks=pytest.mark.slow),
        ("axis scale", {"scale": (2.5, 1.0)}),
    ],
)
def test_a_gross_mistake_is_told(name: str, wrong: dict[str, Any]) -> None:
    one = learned(**wrong)
    assert not one.criticism.trusted
    assert one.criticism.causes[0].score.suspect.name == name


def test_a_weak_push_is_no_miss() -> None:
    assert not [r.text for r in worded(fit_notices(learned(bend=0.03))) if "misses" in r.text]
