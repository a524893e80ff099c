"""What films are made of: coverage of pixels, the camera, the beam's movement, tags as polygons, names and chance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, Uniform
from onebend.errors import MechanicsError, RecordingError
from onebend.lab.bench import PushProfile
from onebend.lab.designs import DESIGNS
from onebend.lab.filming import PLACES, as_printed, between_places, outlines, placed, shapes_at
from onebend.lab.random_bench import FilmRequest, filming_of, random_bench, random_tags
from onebend.lab.rendering import LINES, Camera, PixelBox, all_seen, box_around, coverage, view_from
from onebend.lab.virtual import VirtualBench, VirtualTag, tag_places, tag_poses
from onebend.recording.plane import project, to_plane
from onebend.recording.tag_finder import Finder

BOX = PixelBox(0, 0, 40, 30)
BEAM = Beam(0.15, Powers((0.02, 0.02)), mass_per_length=Uniform(0.4))
REGION = np.array([[0.0, -0.02], [0.15, -0.02], [0.15, 0.1], [0.0, 0.1]])


def polygon(seed: int, corners: int) -> np.ndarray:
    """A convex polygon inside BOX."""
    rng = np.random.default_rng(seed)
    turn = np.sort(rng.uniform(0.0, 2.0 * np.pi, corners))
    return rng.uniform(14.0, 16.0, 2) + rng.uniform(3.0, 12.0) * np.stack([np.cos(turn), np.sin(turn)], axis=-1)


@given(st.integers(0, 10_000), st.integers(3, 9))
@settings(max_examples=30, deadline=None)
def test_coverage_has_the_area_and_centroid_of_the_polygon(seed: int, corners: int) -> None:
    loop = polygon(seed, corners)
    after = np.roll(loop, -1, axis=0)
    cross = loop[:, 0] * after[:, 1] - after[:, 0] * loop[:, 1]
    area = 0.5 * cross.sum()
    centroid = ((loop + after) * cross[:, None]).sum(axis=0) / (6.0 * area)
    cover = coverage(loop[None], BOX)
    rim = np.linalg.norm(after - loop, axis=1).sum()
    assert cover.sum() == pytest.approx(area, abs=0.15 * rim / LINES)  # an edge may lie along the lines: 0.5 at most
    rows, columns = np.indices(cover.shape)
    if area > 20.0:
        found = np.array([(cover * columns).sum(), (cover * rows).sum()]) / cover.sum()
        np.testing.assert_allclose(found, centroid, atol=0.02)


def test_a_rectangle_covers_its_pixels_exactly() -> None:
    cover = coverage(np.array([[[2.25, 3.0], [5.0, 3.0], [5.0, 6.5], [2.25, 6.5]]]), BOX)
    expected = np.zeros(BOX.shape)
    expected[3:7, 2:6] = np.outer([0.5, 1.0, 1.0, 1.0], [0.25, 1.0, 1.0, 0.5])
    np.testing.assert_allclose(cover, expected, atol=1e-6)


def test_neighbours_leave_no_seam_and_what_is_outside_is_cut_off() -> None:
    a, b, c, d = np.array([[3.3, 2.2], [30.1, 4.7], [28.2, 25.5], [-20.0, 22.1]])
    apart = coverage(np.stack([np.stack([a, b, c]), np.stack([a, c, d])]), BOX)
    np.testing.assert_allclose(apart, coverage(np.stack([a, b, c, d])[None], BOX), atol=1e-5)
    part = PixelBox(10, 8, 20, 16)
    np.testing.assert_allclose(
        coverage(np.stack([a, b, c, d])[None], part),
        coverage(np.stack([a, b, c, d])[None], BOX)[8:16, 10:20],
        atol=1e-5,
    )


def test_boxes_are_even_and_within_the_picture() -> None:
    box = box_around(np.array([[-5.0, 3.2], [17.1, 300.0]]), 64, 48)
    assert (box.left, box.top, box.right, box.bottom) == (0, 0, 20, 48)


@pytest.mark.parametrize("camera", [Camera(), Camera(960, 540, 700.0, tilt=(0.3, -0.2), roll=0.4)])
def test_a_camera_stands_as_near_as_shows_everything(camera: Camera) -> None:
    view = view_from(camera, REGION)
    assert all_seen(camera, view, REGION, 0.0)
    np.testing.assert_allclose(to_plane(view, project(view, REGION)), REGION, atol=1e-9)
    distance = float(view.rotation[2, :2] @ REGION.mean(axis=0) + view.translation[2])
    with pytest.raises(RecordingError, match="does not see"):
        view_from(replace(camera, distance=0.7 * distance), REGION)


def test_a_camera_that_cannot_be_is_refused() -> None:
    for wrong in ({"width": 641}, {"focal": 0.0}, {"distance": 0.01}, {"tilt": (1.2, 0.0)}):
        with pytest.raises(RecordingError):
            Camera(**wrong)


def test_a_tag_of_polygons_is_found_where_it_was_put() -> None:
    pose = np.array([90.0, 70.0, 0.3])
    made = outlines(7)
    box = PixelBox(0, 0, 180, 140)
    up = np.array([1.0, -1.0])  # rows of a picture run down
    picture = np.full(box.shape, 120.0)
    for loops, level in ((made.paper, 230.0), (made.ink, 30.0)):
        cover = coverage(placed(60.0 * loops, pose * [1.0, -1.0, 1.0]) * up, box)
        picture += cover * (level - picture)
    (found,) = [tag for tag in Finder("tag36h11").look(picture.astype(np.uint8)) if tag.errors == 0]
    assert found.tag_id == 7
    corners = (
        placed(60.0 * np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]), pose * [1.0, -1.0, 1.0]) * up
    )
    np.testing.assert_allclose(found.corners, corners, atol=0.25)


@settings(deadline=None, max_examples=20)
@given(tag=st.integers(0, 500), phase=st.tuples(st.floats(0.0, 0.999), st.floats(0.0, 0.999)))
def test_a_printer_sets_edges_on_its_grid_and_cells_stay_neighbours(tag: int, phase: tuple[float, float]) -> None:
    size, dot, made = 0.012, 2.54e-2 / 600.0, outlines(tag)
    printed, exact = as_printed(made, size, dot, np.array(phase)), as_printed(made, size, 0.0, np.array(phase))
    assert exact.ink == pytest.approx(size * made.ink, abs=0.0)
    off = printed.ink - exact.ink
    assert np.max(np.abs(off)) <= 0.5 * dot * (1.0 + 1e-9)
    dots = printed.ink / dot + np.array(phase)
    assert np.max(np.abs(dots - np.round(dots))) < 1e-6
    for axis in range(2):  # one place of the design is one place of the print
        places, moved = exact.ink[..., axis].ravel(), printed.ink[..., axis].ravel()
        for place in np.unique(places):
            assert np.ptp(moved[places == place]) == 0.0


def test_interpolation_is_exact_for_cubics() -> None:
    s = np.array([0.0, 0.004, 0.333, 0.5, 0.999, 1.0])
    values = np.stack([PLACES**3 - PLACES, 2.0 * PLACES**2])
    found, exact = between_places(np.stack([values, -values, values], axis=-1), s), np.stack([s**3 - s, 2.0 * s**2])
    np.testing.assert_allclose(found, np.stack([exact, -exact, exact], axis=-1), atol=1e-13)


def test_a_slow_push_shows_exact_equilibria() -> None:
    push = PushProfile(0.4, direction=1.7, at_s=0.8)
    bench = VirtualBench(
        BEAM,
        push,
        tags=(VirtualTag(1, 0.37, across=0.001, turn=0.02), VirtualTag(2, 0.8), VirtualTag(3, 1.0, along=0.002)),
    )
    time = np.linspace(0.0, push.duration, 25)
    found = between_places(shapes_at(BEAM, push, time), tag_places(bench))
    exact = tag_poses(
        replace(bench, tags=(VirtualTag(1, 0.37), VirtualTag(2, 0.8), VirtualTag(3, 1.0))), push.force(time)
    )
    np.testing.assert_allclose(found[..., :2], exact[..., :2], atol=1e-8)
    np.testing.assert_allclose(found[..., 2], exact[..., 2], atol=1e-6)


def test_a_strongly_damped_beam_comes_to_rest_where_statics_say() -> None:
    light = replace(BEAM, mass_per_length=Uniform(0.05))
    push = PushProfile(0.3, direction=1.6, before=0.05, rise=0.1, hold=0.9, fall=0.1, after=0.0, turn=0.0)
    time = np.array([0.0, 1.0])
    gravity = (0.0, -20.0)
    moved = shapes_at(light, push, time, gravity=gravity, swings=True, damping=0.1)[..., :2]
    still = shapes_at(light, push, time, gravity=gravity)[..., :2]
    assert np.max(np.abs(still[1] - still[0])) > 0.03
    np.testing.assert_allclose(moved, still, atol=5e-5)


def test_weight_and_swinging_need_a_mass() -> None:
    bare = Beam(0.15, Uniform(0.02))
    with pytest.raises(MechanicsError, match="mass"):
        shapes_at(bare, PushProfile(0.1), np.array([0.0, 1.0]), gravity=(0.0, -9.81))


def test_pushes_follow_what_is_asked_for() -> None:
    design = DESIGNS["linear"]
    asked = filming_of(
        design, FilmRequest(push="s08", at_s=0.7, force=0.2, seconds=3.0, direction=-1.5, fps=12.0), "x"
    ).bench
    assert (asked.push.at_s, asked.push.peak, asked.push.direction, asked.fps) == (0.7, 0.2, -1.5, 12.0)
    begin, end = asked.push.contact
    assert end - begin == pytest.approx(3.0)
    bent = filming_of(design, FilmRequest(bend=0.8), "x").bench.push
    tip = design.beam().equilibrium(bent.peak * np.array([np.cos(bent.direction), np.sin(bent.direction)])).angle(1.0)
    assert float(tip) == pytest.approx(0.8, abs=0.02)
    assert filming_of(design, FilmRequest(push="free"), "x").swings
    with pytest.raises(RecordingError, match="no push 'quick'"):
        filming_of(design, FilmRequest(push="quick"), "x")  # type: ignore[arg-type]
    with pytest.raises(RecordingError, match="above zero"):
        filming_of(design, FilmRequest(force=-1.0), "x")


def test_benches_are_drawn_again_from_the_same_seed_and_never_alike_from_another() -> None:
    one, same, other = (random_bench(np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert one == same
    assert one != other
    assert abs(one.bench.clock.declared - one.bench.clock.offset) <= one.bench.clock.uncertainty


def test_drawn_tags_have_the_tolerance_that_is_told() -> None:
    drawn = [tag for seed in range(200) for tag in random_tags(np.random.default_rng(seed), 4e-4)]
    assert np.std([tag.along for tag in drawn]) == pytest.approx(4e-4, rel=0.1)
    assert np.std([tag.across for tag in drawn]) == pytest.approx(4e-4, rel=0.1)
    assert {sum(tag.s == 1.0 for tag in drawn)} == {200}
