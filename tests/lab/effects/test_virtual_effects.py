"""Virtual recordings of real benches: each effect shows in poses, log or declared values, and the truth says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.errors import RecordingError
from onebend.lab.bench import PushProfile, RealBench, TagNoise, section_flexibility
from onebend.lab.designs import DESIGNS, force_that_bends, random_stiffness
from onebend.lab.filming import Filming
from onebend.lab.random_bench import (
    EFFECTS,
    LABORATORY,
    OF_THE_PICTURE,
    BenchRanges,
    FilmRequest,
    design_with_effects,
    filming_of,
    random_bench,
    with_random_effects,
)
from onebend.lab.virtual import (
    VirtualBench,
    VirtualClock,
    VirtualRecording,
    observe_virtual,
    true_stiffness,
    virtual_recording,
)
from onebend.learning.instruments import setup_of
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import fit
from tests.lab.effects.chosen import only
from tests.lab.from_truth import observe_from_truth

pytestmark = pytest.mark.usefixtures("no_other_places")

S = np.linspace(0.0, 1.0, 401)
BEAM = Beam(0.15, random_stiffness("smooth", np.random.default_rng(3)))
PUSH = PushProfile(force_that_bends(BEAM, 1.0, 1.75))
KNOWN = VirtualClock(uncertainty=0.0)
BENCH = VirtualBench(BEAM, PUSH, camera=TagNoise(white_xy=1e-7, white_angle=1e-5), clock=KNOWN)


def made(seed: int = 0, **effects: object) -> VirtualRecording:
    return virtual_recording(replace(BENCH, effects=RealBench(**effects)), seed=seed)  # type: ignore[arg-type]


def test_no_effect_is_the_recording_of_before() -> None:
    plain, none = virtual_recording(BENCH, seed=4), made(4)
    np.testing.assert_array_equal(plain.markers.xy, none.markers.xy)
    np.testing.assert_array_equal(plain.log.force, none.log.force)
    assert plain.motion is none.motion is None
    truth = true_stiffness(plain.bench, plain.motion, S)
    for k in (truth.k, truth.k_instant, truth.k_bare):
        np.testing.assert_array_equal(k, BEAM.stiffness(S))


def test_effects_of_size_zero_through_the_march_move_nothing() -> None:
    marched = made(4, relaxation=1e-12)
    assert marched.motion is not None
    np.testing.assert_allclose(marched.pose, virtual_recording(BENCH, seed=4).pose, atol=2e-6)


def test_the_truth_has_patches_and_the_secant_modulus() -> None:
    one = made(patch_factor=1.8, patch_length=0.015, relaxation=0.1, relaxation_time=1.0)
    truth = true_stiffness(one.bench, one.motion, S)
    under = np.min(np.abs(S[:, None] - np.array([1 / 3, 2 / 3, 1.0])), axis=1) < 0.05
    np.testing.assert_allclose(truth.k_instant / truth.k_bare, np.where(under, 1.8, 1.0))
    secant = truth.k / truth.k_instant
    assert np.ptp(secant) < 1e-12
    assert 0.9 < secant[0] < 1.0


@pytest.mark.slow
def test_a_static_fit_finds_the_secant_modulus() -> None:
    """Relaxation quick against the push leaves a beam that is softer by its share."""
    one = made(relaxation=0.1, relaxation_time=0.02)
    inner = np.linspace(0.1, 0.85, 40)
    truth = true_stiffness(one.bench, one.motion, inner)
    np.testing.assert_allclose(truth.k, 0.9 * truth.k_bare, rtol=2e-3)
    found = fit([observe_virtual(one)], settings=FitSettings(functions=16, most_frames=80, first_frames=40))
    np.testing.assert_allclose(found.band(inner).k, truth.k, rtol=0.05)


def test_a_posture_bias_has_its_size_and_is_none_at_rest() -> None:
    clean, off = made(), made(posture_bias=0.04)
    np.testing.assert_allclose(off.pose, clean.pose, atol=2e-6)
    error = off.log.force - clean.log.force
    film = off.log.time - BENCH.clock.offset
    begin, end = PUSH.contact
    np.testing.assert_allclose(error[(film < begin) | (film > end)], 0.0, atol=1e-9)
    assert np.max(np.linalg.norm(error, axis=1)) == pytest.approx(0.04 * PUSH.peak, rel=1e-3)


def test_what_is_said_of_the_length_is_off() -> None:
    assert made(length_off=0.01).recording.beam.length == pytest.approx(0.1515)


def test_sizes_that_cannot_be_are_refused() -> None:
    with pytest.raises(RecordingError, match="share"):
        RealBench(relaxation=1.0)
    with pytest.raises(RecordingError, match="negative"):
        RealBench(thickness=-1e-3)


def drawn(seed: int, *names: str) -> VirtualBench:
    rng = np.random.default_rng(seed)
    return with_random_effects(BENCH, rng, only(*names) if names else LABORATORY)


def test_an_effect_left_out_changes_no_other() -> None:
    every = drawn(7, *EFFECTS)
    for name in EFFECTS:
        others = drawn(7, *(one for one in EFFECTS if one != name))
        same = [getattr(every.effects, f) == getattr(others.effects, f) for f in RealBench.__dataclass_fields__]
        gone = sum(not one for one in same) + (every.tags != others.tags) + (every.sensor != others.sensor)
        assert gone == (0 if name == "inertia" else 1), name  # this beam's mass is not known


def test_one_effect_alone_is_alone() -> None:
    assert drawn(7, "slide").effects.slide != 0.0
    assert drawn(7, "slide").tags == BENCH.tags
    for name in OF_THE_PICTURE:
        assert drawn(7, name).effects != drawn(7, "inertia").effects  # which does nothing: the mass is not known
        assert not drawn(7, name).effects.moves_otherwise


@pytest.mark.slow
def test_pushes_of_the_tip_stay_on_the_beam() -> None:
    for seed in range(5):
        one = virtual_recording(replace(drawn(seed, "slide", "push_off"), fps=4.0), seed=seed)
        assert one.motion is not None
        assert np.all(np.diff(one.motion.contact[: len(one.motion.contact) // 2]) <= 0.0)
        assert one.motion.contact[0] <= 1.0


def test_a_design_is_as_thick_as_its_width_says() -> None:
    design = DESIGNS["linear"]
    plain = filming_of(design, FilmRequest(), "linear")
    real = design_with_effects(plain, np.random.default_rng(1), only("stretch"))
    stretch, shear = section_flexibility(plain.bench.beam, real.bench.effects, S)
    area = np.asarray(design.width(S)) * design.depth
    np.testing.assert_allclose(1.0 / stretch, design.modulus * area, rtol=1e-3)
    np.testing.assert_allclose(stretch / shear, 5.0 / 6.0 / 2.9)


def test_a_mass_is_told_where_the_motion_shows_it() -> None:
    """A fit takes a stated mass for one that has inertia."""
    plain = filming_of(DESIGNS["linear"], FilmRequest(), "linear")

    def told(filming: Filming, effect: str) -> bool:
        return design_with_effects(filming, np.random.default_rng(1), only(effect)).mass_told

    assert plain.mass_told
    assert not told(plain, "stretch")
    assert told(plain, "inertia")
    assert told(replace(plain, gravity=9.81), "stretch")
    assert told(replace(plain, swings=True), "heights")


def test_random_benches_are_the_same_but_for_their_effects() -> None:
    plain = random_bench(np.random.default_rng(5))
    real = random_bench(np.random.default_rng(5), BenchRanges(effects=LABORATORY))
    assert plain.bench.effects == RealBench()
    assert real.bench.effects != RealBench()
    for name in ("camera", "scene", "tag_size", "lost", "calibrated"):
        assert getattr(real, name) == getattr(plain, name)
    assert real.bench.beam == plain.bench.beam
    assert real.bench.effects.thickness > 0.0
    thickness = np.asarray(real.width(S)) / np.cbrt(np.asarray(real.bench.beam.stiffness(S)))
    np.testing.assert_allclose(thickness, thickness[0], rtol=1e-3)  # drawn as wide as it is thick
    assert real.bench.effects.patch_length == pytest.approx(1.25 * real.tag_size)


@pytest.mark.slow
def test_a_set_up_is_as_relaxed_as_the_push_was_at_the_end_of_its_hold() -> None:
    """The beam creeps by 3 mm while it is held; the force is largest as early as late."""
    bench = replace(BENCH, push=replace(PUSH, turn=0.0, hold=3.0))
    film = virtual_recording(replace(bench, effects=RealBench(relaxation=0.12, relaxation_time=1.0)), seed=0)
    found = fit([observe_from_truth(film)], settings=FitSettings(allowances=frozenset({"relaxation"})))
    setup = setup_of(found)
    assert setup is not None
    force = film.force[int(np.argmax(np.linalg.norm(film.force, axis=1)))]
    tip = setup.bent(found.beam, found.stiffness, force[None]).tags()[0, -1, :2]
    begin, end = (int(np.searchsorted(film.markers.time, PUSH.before + PUSH.rise + held)) for held in (0.0, 3.0))
    assert np.linalg.norm(tip - film.pose[end - 1, -1, :2]) < 3e-4
    assert np.linalg.norm(tip - film.pose[begin, -1, :2]) > 2e-3
