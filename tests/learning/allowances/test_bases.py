"""What the small allowances put into the model: sliding contact, posture, clamp, length, section, discrepancy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from onebend.errors import LearningError
from onebend.learning.allowances import (
    EVERY_ALLOWANCE,
    KNOWN_SD,
    OF_ONE,
    POSTURE_SD,
    UNKNOWN_SD,
    USUAL_THICKNESS,
    Allowance,
    PushCourse,
    angle_discrepancy,
    discrepancy,
    giving,
    posture_bias,
    section,
    section_at,
    sliding,
)
from onebend.learning.fit_data import fit_data
from onebend.learning.parameters import Spline
from onebend.learning.prediction import State, predict
from onebend.learning.sites import is_shaped
from tests.learning.allowances.allowed_bench import PUSH_S, TAGS, course, filmed, with_everything
from tests.learning.bench import forces

MADE = filmed()
RUN = course()


def of(make: Callable[[PushCourse], Allowance | None]) -> Callable[[PushCourse], Allowance]:
    """What cannot be missing here."""

    def made(course: PushCourse) -> Allowance:
        one = make(course)
        assert one is not None
        return one

    return made


def test_the_contact_slides_by_the_turn_of_the_beam_there() -> None:
    basis = of(sliding)(RUN).basis
    here = (PUSH_S - TAGS[1]) / (TAGS[2] - TAGS[1])
    turn = MADE.angle - MADE.rest_angle
    np.testing.assert_allclose(basis[:20, 0], (1.0 - here) * turn[:, 1] + here * turn[:, 2], atol=1e-12)
    assert basis[20, 0] == 0.0


def test_below_the_first_tag_it_slides_by_a_share_of_its_turn() -> None:
    basis = of(sliding)(replace(RUN, push_s=np.full(21, 0.5 * TAGS[0]))).basis
    np.testing.assert_allclose(basis[:20, 0], 0.5 * (MADE.angle - MADE.rest_angle)[:, 0], atol=1e-12)


def test_the_clamp_turns_with_the_tag_next_to_it() -> None:
    one = giving(RUN)
    np.testing.assert_allclose(one.basis[:20, 0], (MADE.angle - MADE.rest_angle)[:, 0], atol=1e-12)
    assert one.basis[20, 0] == 0.0


def test_a_posture_bias_is_a_polynomial_in_the_place_of_the_push_and_nothing_at_rest() -> None:
    one, force = of(posture_bias)(RUN), forces(20)
    values = np.arange(1.0, 11.0)  # x, y, x^2, x y, y^2 of the force along x, then along y
    assert one.labels == tuple(f"posture bias {axis}{i}" for axis in "xy" for i in range(1, 6))
    here = (PUSH_S - TAGS[1]) / (TAGS[2] - TAGS[1])
    moved = (MADE.xy - MADE.rest_xy) / MADE.length
    x, y = ((1.0 - here) * moved[:, 1] + here * moved[:, 2]).T
    terms = np.stack([x, y, x * x, x * y, y * y], axis=1)
    np.testing.assert_allclose((one.basis @ values)[:20], terms @ values.reshape(2, 5).T, atol=1e-12)
    assert np.all(one.basis[20] == 0.0)
    at_largest = np.sqrt(np.sum((terms * one.prior_sd[:5]) ** 2, axis=1))
    assert np.max(at_largest) < POSTURE_SD * np.max(np.linalg.norm(force, axis=1)) * (1.0 + 1e-9)


def test_a_posture_bias_of_frames_as_they_come_is_quadratic_in_the_displacement() -> None:
    one = of(posture_bias)(replace(RUN, film=None))
    bend = RUN.bend
    np.testing.assert_allclose((one.basis @ [1.0, -2.0, 3.0, 0.5])[:, 0], bend - 2.0 * bend**2, atol=1e-12)
    np.testing.assert_allclose((one.basis @ [1.0, -2.0, 3.0, 0.5])[:, 1], 3.0 * bend + 0.5 * bend**2, atol=1e-12)


def test_each_discrepancy_moves_one_coordinate_of_one_tag_smoothly() -> None:
    places, angles = of(discrepancy)(RUN), of(angle_discrepancy)(RUN)
    assert len(places.labels) == places.basis.shape[-1] == 2 * 3 * 5
    assert len(angles.labels) == angles.basis.shape[-1] == 3 * 5
    for one, axes in ((places, "xy"), (angles, "angle")):
        for label, basis in zip(one.labels, np.moveaxis(one.basis, -1, 0), strict=True):
            _, _, tag, what = label.split()
            axis = 2 if axes == "angle" else "xy".index(what[0])
            moved = np.flatnonzero(np.any(basis != 0.0, axis=0).ravel())
            assert moved.tolist() == [3 * (int(tag) - 1) + axis], label
            assert np.all(basis[20] == 0.0)
    np.testing.assert_allclose(places.basis[:20, 1, 0, places.labels.index("discrepancy tag 2 x1")], RUN.bend[:20] ** 2)


def test_a_section_is_as_thick_as_stated_or_as_usual() -> None:
    assert section(replace(RUN, thick=True)).prior_sd[0] == KNOWN_SD
    assert section(replace(RUN, thick=False)).prior_sd[0] == UNKNOWN_SD
    one, layout, x = with_everything(share=0.0)
    change = float(x[layout.index["section", -1].start])
    made, _ = State(one, layout, x).section
    assert made is not None
    assert made.thickness == pytest.approx(USUAL_THICKNESS * 0.15)
    assert made.share == pytest.approx(1.0 + change)
    stated = replace(one.observations.stated, thickness=0.02)
    known, _ = State(replace(one, observations=replace(one.observations, stated=stated)), layout, x).section
    assert known is not None
    assert known.thickness == 0.02


def test_stretch_goes_with_its_parameter_through_nothing() -> None:
    k, weights, length = np.array([0.02, 0.05]), np.array([0.5, 0.5]), np.array(0.15)
    usual = section_at(0.0, np.nan, 0.15)[0].compliance(k, weights, length)[0]
    for change in (-2.0, -1.0, -0.3, 3.0):
        made, slope = section_at(change, np.nan, 0.15)
        found = made.compliance(k, weights, length)[0]
        np.testing.assert_allclose(found, (1.0 + change) * usual, atol=1e-8 * float(np.max(usual)))
        np.testing.assert_allclose(2.0 * slope * found, usual)  # its derivative with the parameter


def test_a_longer_beam_puts_its_tags_farther_out() -> None:
    one, layout, _ = with_everything(share=0.0)
    x = np.zeros(layout.size)
    x[layout.index["stiffness", -1].where] = 5.0  # hardly bends
    block = layout.index["length", -1]
    assert not is_shaped(block)  # with a prior that has most of its mass near zero, the tip missed its ellipse
    x[block.start] = 0.01
    assert State(one, layout, x).length == pytest.approx(0.15 * np.exp(0.01))
    np.testing.assert_allclose(predict(one, layout, x, None).pose[0, :, 0], 0.15 * np.exp(0.01) * TAGS, rtol=1e-3)


def test_allowances_of_one_kind_add_up() -> None:
    one, layout, x = with_everything(share=0.0)
    assert isinstance(State(replace(one, allowances=()), layout, x).allowed("poses"), float)
    parts = [a for a in one.allowances if a.enters == "poses"]
    own = [a.basis @ layout.get(x, a.name, -1 if a.shared else 0) for a in parts]
    np.testing.assert_allclose(State(one, layout, x).allowed("poses"), np.sum(own, axis=0), atol=1e-15)


WEIGHING = {"gravity direction"}  # nothing weighs here


def chosen(wanted: frozenset[str] = EVERY_ALLOWANCE, **changed: object) -> set[str]:
    made = replace(MADE, **changed)  # type: ignore[arg-type]
    one = fit_data(made, 0, np.ones(20, dtype=bool), Spline(7), wanted)
    return {a.name for a in one.allowances}


def test_every_name_is_an_allowance_of_a_film_of_a_push() -> None:
    assert chosen() == OF_ONE - WEIGHING - {"outline", "outline height", "light"}


def test_only_what_is_wanted_is_allowed_for() -> None:
    assert chosen(frozenset({"length", "slide"})) == {"length", "slide"}
    assert chosen(frozenset()) == set()
    with pytest.raises(LearningError, match="no allowance 'lenght', only: angle discrepancy"):
        chosen(frozenset({"lenght"}))


def test_without_a_push_nothing_slides_and_static_poses_have_none() -> None:
    still = np.zeros((20, 2))
    of_a_push = {"slide", "rub", "posture", "lag", "hysteresis"}
    assert OF_ONE - chosen(force=still) == {*WEIGHING, "outline", "outline height", "light", *of_a_push}
    assert chosen(static=True) == set()


def test_tracks_have_no_allowances_of_a_camera() -> None:
    tracked = replace(MADE.source, view=None)
    assert OF_ONE - chosen(source=tracked) == {
        *WEIGHING,
        "outline",
        "outline height",
        "light",
        "rolling shutter",
    }
