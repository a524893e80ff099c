"""From corners to poses: the lens and its inverse, the plane and the camera from the tags, honest covariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from onebend.errors import ObservationError, RecordingError
from onebend.recording.camera import (
    Poses,
    base_pose,
    corner_weight,
    measure_markers,
    measure_poses,
    relative_to,
    unwrap,
)
from onebend.recording.entries import Recording, TagEntry
from onebend.recording.plane import (
    LYING_SD,
    distort,
    fit_plane,
    lay_square,
    project,
    project_tags,
    square,
    to_plane,
    undistort,
)
from onebend.records import Array, Detections, covariance_with_camera, unit
from tests.recording.filmed import HEIGHT, LENGTH, SIZE, WIDTH, corners_of, detections, poses, recording, view

TRUE = poses(60)
SEEN = view()


def relative_truth(true: Array) -> Array:
    """Poses (T, m, 3) in the base tag's frame, by complex numbers."""
    place = true[..., 0] + 1j * true[..., 1]
    off = (place[:, 1:] - place[:, :1]) * np.exp(-1j * true[:, :1, 2])
    return np.stack([off.real, off.imag, true[:, 1:, 2] - true[:, :1, 2]], axis=-1)


def errors(found: Detections, rec: Recording, true: Array) -> tuple[Array, Array]:
    """Errors (T, m, 3) of the markers and their normalised squares (T, m)."""
    markers = measure_markers(found, rec)
    error = np.concatenate([markers.xy, markers.angle[..., None]], axis=-1) - relative_truth(true)
    return error, np.einsum("tmi,tmij,tmj->tm", error, np.linalg.inv(covariance_with_camera(markers)), error)


@given(
    st.tuples(st.floats(-0.2, 0.2), st.floats(-0.05, 0.05), st.floats(-3e-3, 3e-3), st.floats(-3e-3, 3e-3)),
    st.tuples(st.floats(-0.6, 0.6), st.floats(-0.4, 0.4)),
)
def test_lens_is_undone(dist: tuple[float, ...], ray: tuple[float, float]) -> None:
    lens, point = np.array([*dist, 0.01]), np.array([ray])
    assert undistort(distort(point, lens), lens) == pytest.approx(point, abs=1e-8)


def test_lens_that_folds_over_gives_no_point() -> None:
    strong = np.array([-0.5, 0.0, 0.0, 0.0, 0.0])  # x (1 - x^2 / 2) is never more than 0.544
    found = undistort(np.array([[0.5, 0.0], [0.6, 0.0]]), strong)
    assert np.isfinite(found[0]).all()
    assert np.isnan(found[1]).all()


@given(st.tuples(st.floats(-0.1, 0.1), st.floats(-0.05, 0.05)), st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6)))
def test_plane_and_picture_are_inverse(xy: tuple[float, float], tilt: tuple[float, float]) -> None:
    seen = view(tilt=tilt)
    point = np.array([xy])
    assert to_plane(seen, project(seen, point)) == pytest.approx(point, abs=1e-9)


def test_picture_has_y_down_and_the_plane_y_up() -> None:
    facing = view(tilt=(0.0, 0.0))
    origin, right, up = project(facing, np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 0.01]]))
    assert right[0] > origin[0]
    assert up[1] < origin[1]


@given(st.floats(-3.1, 3.1), st.floats(-0.1, 0.1), st.floats(0.001, 0.1))
def test_square_is_laid_on_a_square(angle: float, x: float, size: float) -> None:
    place, turn = lay_square(square(np.array([x, -x]), np.array(angle), size))
    assert place == pytest.approx([x, -x])
    assert float(turn) == pytest.approx(angle)


def test_exact_corners_give_exact_poses() -> None:
    error, _ = errors(detections(corners_of(TRUE, SEEN)), recording(calibrated=SEEN), TRUE)
    assert np.abs(error).max() < 3e-6


def test_uncalibrated_camera_is_inferred_from_exact_corners() -> None:
    plain = replace(view(tilt=(0.35, -0.3), dist=(-0.05, 0, 0, 0, 0)))
    plain = replace(plain, matrix=np.array([[600.0, 0, 319.5], [0, 600.0, 179.5], [0, 0, 1]]))
    error, _ = errors(detections(corners_of(TRUE, plain)), recording(), TRUE)
    assert np.sqrt((error[..., :2] ** 2).mean()) < 4e-5


def edge_noise(corners: Array, sd: float, seed: int) -> Array:
    """Errors (..., 4, 2) px of a detector that fits each edge, from the normal errors at its two ends."""
    random = np.random.default_rng(seed)
    error = np.zeros_like(corners)
    for a, b in ((0, 1), (1, 2), (2, 3), (3, 0)):
        along = corners[..., b, :] - corners[..., a, :]
        normal = np.stack([-along[..., 1], along[..., 0]], axis=-1) / np.linalg.norm(along, axis=-1, keepdims=True)
        shift, slope = random.standard_normal((2, *corners.shape[:-2]))
        for end, sign in ((a, -1.0), (b, 1.0)):
            error[..., end, :] += sd * (0.5 * shift + sign * np.sqrt(0.75) * slope)[..., None] * normal
    return error


def test_weight_is_the_inverse_covariance_of_edge_errors() -> None:
    corners = corners_of(np.array([0.05, 0.0, 0.4]), SEEN)
    errors_seen = edge_noise(np.broadcast_to(corners, (200_000, 4, 2)), 1.0, 0).reshape(-1, 8)
    assert corner_weight(corners) @ np.cov(errors_seen.T) == pytest.approx(np.eye(8), abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("calibrated", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_covariance_is_honest(calibrated: bool) -> None:
    """Normalised squared errors over noisy films have the median of chi-squared with 3 degrees of freedom.

    The base stands still: its error is the same in every frame of a film, and none of the tags'.
    """
    true = TRUE[::4]
    exact, squares = corners_of(true, SEEN), []
    for seed in range(5):
        noise = edge_noise(exact, 0.3, seed)
        noise[:, 0] = 0.0
        rec = recording(calibrated=SEEN if calibrated else None)
        squares.append(errors(detections(exact + noise), rec, true)[1])
    # These films are without the lasting errors of a lens that the plane is fitted with.
    assert 0.4 < np.median(squares) / 2.366 < 1.4


@pytest.mark.slow
def test_noise_of_the_corners_is_found() -> None:
    for sd in (0.05, 0.4):
        found = measure_markers(detections(corners_of(TRUE, SEEN), sd=sd), recording(calibrated=SEEN))
        assert found.view is not None
        assert found.view.corner_sd == pytest.approx(sd, rel=0.15)


def test_corner_noise_does_not_hide_in_one_bad_tag() -> None:
    """One bent tag is left out with a remark, and the others stay as good as they were."""
    corners = corners_of(TRUE, SEEN)
    corners[20:25, 2, 0] += 4.0
    markers = measure_markers(detections(corners, sd=0.05), recording(calibrated=SEEN))
    assert np.isnan(markers.xy[20:25, 1]).all()
    assert np.isnan(markers.angle[20:25, 1]).all()
    assert np.isfinite(markers.xy).all(axis=2).sum() == 60 * 3 - 5
    assert any("Tag 2 was left out in 5 frames" in remark.text for remark in markers.remarks)


def test_bent_base_tag_is_refused() -> None:
    corners = corners_of(TRUE, SEEN)
    corners[:, 0, 2] += 6.0
    with pytest.raises(ObservationError, match="base tag's shape fits no flat square"):
        measure_markers(detections(corners), recording(calibrated=SEEN))


@pytest.mark.slow
@pytest.mark.parametrize("calibrated", [True, False])
def test_raised_and_tilted_tags_are_where_they_are(calibrated: bool) -> None:
    """Angles are twice as near as those of tags that count as flat under the true camera, and errors are as said."""
    rng = np.random.default_rng(4)
    lying = rng.normal(0.0, LYING_SD, (4, 11))
    lying[:, :3] = [[1e-3, 0.0, 0.02], [-1e-3, 0.06, -0.03], [5e-4, -0.05, 0.04], [0.0, 0.03, 0.05]]
    corners = project_tags(SEEN, TRUE[..., :2], TRUE[..., 2], SIZE, lying)
    rec = recording(calibrated=SEEN if calibrated else None)
    off, squares = errors(detections(corners), rec, TRUE)
    as_flat, _, _ = measure_poses(replace(SEEN, lying=np.zeros((0, 11))), corners, SIZE)
    flat = relative_truth(np.concatenate([as_flat.xy, as_flat.angle[..., None]], axis=-1)) - relative_truth(TRUE)
    moved, before = (np.sqrt(np.mean((one - one[:1]) ** 2, axis=(0, 1))) for one in (off, flat))
    assert moved[2] < 0.5 * before[2]
    assert np.all(moved[:2] < 1e-4)
    assert np.median(squares) < 2.0 * 2.366
    found = measure_markers(detections(corners), rec).view
    assert found is not None
    np.testing.assert_allclose(found.lying[:, 1:3], lying[:, 1:3], atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("calibrated", [True, False])
def test_one_frame_is_enough_for_a_pose(calibrated: bool) -> None:
    facing = view(tilt=(0.0, 0.0), dist=(0.0,) * 5)
    error, squares = errors(
        detections(corners_of(TRUE[30:31], facing)), recording(calibrated=facing if calibrated else None), TRUE[30:31]
    )
    assert np.abs(error[..., :2]).max() < 5e-4
    assert np.isfinite(squares).all()


@pytest.mark.slow
def test_missing_tags_stay_missing() -> None:
    corners = corners_of(TRUE, SEEN)
    corners[10:20, 3] = np.nan  # the tip
    corners[30:40, 0] = np.nan  # the base, which stands still
    markers = measure_markers(detections(corners, sd=0.05), recording(calibrated=SEEN))
    assert np.isnan(markers.covariance[10:20, 2]).all()
    assert np.isfinite(markers.xy[10:20, :2]).all()
    assert np.isfinite(markers.xy[30:40]).all()
    assert (markers.base_angle == 0).all()


@pytest.mark.slow
def test_a_hidden_base_tag_leaves_the_covariance_known() -> None:
    seen, true = view(), poses(60)
    whole = measure_markers(detections(corners_of(true, seen), sd=0.03), recording(calibrated=seen))
    found = detections(corners_of(true, seen), sd=0.03)
    found.corners[[0, 7, 8, 59], 0] = np.nan
    hidden = measure_markers(found, recording(calibrated=seen))
    assert np.isfinite(hidden.xy).all()
    assert np.isfinite(hidden.covariance).all()
    assert np.allclose(hidden.covariance, whole.covariance, rtol=0.3, atol=1e-11)


def test_turned_tags_give_the_same_markers() -> None:
    turns = np.array([np.pi / 2, -np.pi / 2, np.pi, 0.3])
    turned = TRUE + np.stack([0 * turns, 0 * turns, turns], axis=-1)
    error, _ = errors(detections(corners_of(turned, SEEN)), recording(calibrated=SEEN, turns=turns.tolist()), TRUE)
    assert np.abs(error).max() < 3e-6


def test_moving_base_is_followed_and_remarked() -> None:
    turn = 0.8 * np.sin(np.linspace(0, 3, 60))
    place = (TRUE[..., 0] + 1j * TRUE[..., 1]) * np.exp(1j * turn)[:, None]
    moved = np.stack([place.real, place.imag, TRUE[..., 2] + turn[:, None]], axis=-1)
    seen = replace(view(), translation=np.array([-0.05, 0.0, 0.4]))
    markers = measure_markers(detections(corners_of(moved, seen)), recording(calibrated=seen))
    assert np.concatenate([markers.xy, markers.angle[..., None]], axis=-1) == pytest.approx(
        relative_truth(TRUE), abs=3e-6
    )
    assert markers.base_angle == pytest.approx(turn - turn[0], abs=3e-6)
    assert any("The base moves" in remark.text for remark in markers.remarks)
    assert markers.view is not None
    first = project(markers.view, markers.xy[0])
    assert first == pytest.approx(corners_of(moved, seen)[0, 1:].mean(axis=1), abs=0.3)


def test_view_is_that_of_the_base_frame() -> None:
    markers = measure_markers(detections(corners_of(TRUE, SEEN)), recording(calibrated=SEEN))
    assert markers.view is not None
    assert project(markers.view, markers.xy) == pytest.approx(project(SEEN, TRUE[:, 1:, :2]), abs=5e-3)
    assert np.linalg.det(markers.view.rotation) == pytest.approx(1.0)


def test_several_base_tags_and_one_behind_its_place() -> None:
    """The frame's origin is s = 0 on the axis of the first base tag; where that is hidden, the second stands in."""
    corners = corners_of(TRUE, SEEN)
    corners[:30, 0] = np.nan
    rec = recording(calibrated=SEEN)
    other = TagEntry(7, 0.2, 0.1)
    tags = replace(rec.tags, on_base=(replace(rec.tags.on_base[0], s=0.01), other))
    extra = corners_of(np.broadcast_to([0.031, 0.02, 0.1], (60, 3)), SEEN)[:, None]
    both = replace(
        detections(np.concatenate([corners[:, :1], extra, corners[:, 1:]], axis=1)), tag_id=np.array([0, 7, 1, 2, 3])
    )
    markers = measure_markers(both, replace(rec, tags=tags))
    expected = relative_truth(TRUE)
    expected[..., 0] += 0.01 * LENGTH
    assert np.concatenate([markers.xy, markers.angle[..., None]], axis=-1) == pytest.approx(expected, abs=3e-6)


def test_base_is_averaged_by_weight() -> None:
    state = np.zeros((30, 2, 3))
    covariance = np.broadcast_to(np.eye(3), (30, 2, 3, 3)).copy()
    covariance[:, 1] *= 3.0
    state[:, 1, 0] = 0.4  # a constant distance is learned, not averaged
    poses_seen = Poses(state[..., :2], state[..., 2], covariance)
    pose, moving = base_pose(poses_seen, (TagEntry(0, 0.0), TagEntry(1, 0.0)), 1.0)
    assert not moving
    assert pose.xy[0, 0] == pytest.approx([0.0, 0.0])
    assert np.all(pose.covariance == 0.0)  # an error of every frame alike is the mounting's
    alone, _ = base_pose(
        Poses(state[:1, :, :2], state[:1, :, 2], covariance[:1]), (TagEntry(0, 0.0), TagEntry(1, 0.0)), 1.0
    )
    assert alone.covariance[0, 0] == pytest.approx(0.75 * np.eye(3))


@pytest.mark.parametrize("factor", [0.5, 1.2, 2.0])
def test_wrong_tag_size_or_length_is_refused(factor: float) -> None:
    with pytest.raises(ObservationError, match=r"mm apart.*size_m .*about 12 mm would fit.*length_m"):
        measure_markers(detections(corners_of(TRUE, SEEN)), recording(calibrated=SEEN, size=SIZE * factor))


def test_a_tag_that_moved_is_no_wrong_size_or_place() -> None:
    slid = TRUE.copy()
    slid[30:, 3, :2] += 0.15 * LENGTH * unit(slid[30:, 3, 2])
    with pytest.raises(ObservationError, match=r"At first it is .* mm: one slid or came off") as caught:
        measure_markers(detections(corners_of(slid, SEEN)), recording(calibrated=SEEN))
    assert "size_m" not in str(caught.value)
    elsewhere = recording(calibrated=SEEN)
    *others, tip = elsewhere.tags.on_beam
    elsewhere = replace(elsewhere, tags=replace(elsewhere.tags, on_beam=(*others, replace(tip, s=tip.s - 0.15))))
    with pytest.raises(ObservationError, match=r"Correct length_m .* or the tags' s\."):
        measure_markers(detections(corners_of(TRUE, SEEN)), elsewhere)


def test_calibration_of_another_picture_is_refused() -> None:
    wrong = replace(detections(corners_of(TRUE, SEEN)), width=1920, height=1080)
    with pytest.raises(RecordingError, match="640 x 360, the video has 1920 x 1080"):
        measure_markers(wrong, recording(calibrated=SEEN))


def test_tags_that_are_no_squares_in_a_plane_are_refused() -> None:
    corners = corners_of(TRUE, SEEN)
    corners[:, :, 0, 0] += 16.0
    with pytest.raises(ObservationError, match="No flat plane"):
        measure_markers(detections(corners), recording(calibrated=SEEN))


@given(st.integers(0, 1000))
def test_relative_pose_and_its_covariance_agree_with_sampling(seed: int) -> None:
    random = np.random.default_rng(seed)
    state = random.uniform(-1, 1, (2, 3))
    root = 1e-3 * random.uniform(-1, 1, (2, 3, 3))
    covariance = root @ np.swapaxes(root, -1, -2)

    def between(both: Array) -> Array:
        base, tag = (Poses(row[..., None, :2], row[..., None, 2], np.zeros((*row.shape[:-1], 1, 3, 3))) for row in both)
        found = relative_to(base, tag)
        return np.concatenate([found.xy[..., 0, :], found.angle], axis=-1)

    exact = [
        Poses(row[None, None, :2], row[None, None, 2], cov[None, None])
        for row, cov in zip(state, covariance, strict=True)
    ]
    claimed = relative_to(*exact).covariance[0, 0]
    step = 1e-6
    jacobian = np.zeros((3, 6))
    for k in range(6):
        shift = np.zeros((2, 1, 3))
        shift[k // 3, 0, k % 3] = step
        jacobian[:, k] = (between(state[:, None] + shift) - between(state[:, None] - shift))[0] / (2 * step)
    whole = np.zeros((6, 6))
    whole[:3, :3], whole[3:, 3:] = covariance
    assert claimed == pytest.approx(jacobian @ whole @ jacobian.T, rel=1e-5, abs=1e-14)


@given(st.lists(st.floats(-1.5, 1.5), min_size=2, max_size=30), st.integers(0, 2**20))
def test_angles_are_continuous_and_start_near_zero(steps: list[float], holes: int) -> None:
    true = np.cumsum(steps)
    true += -2 * np.pi * np.round(true[0] / (2 * np.pi))
    wrapped = np.angle(np.exp(1j * true))
    wrapped[[bool(holes >> i & 1) and i > 0 and steps[i] == 0 for i in range(len(true))]] = np.nan
    found = unwrap(wrapped[:, None])[:, 0]
    known = np.isfinite(wrapped)
    assert found[known] == pytest.approx(true[known], abs=1e-9)


@pytest.mark.parametrize("calibrated", [True, False])
def test_one_tag_in_one_picture_gives_the_plane(calibrated: bool) -> None:
    """A photo with a tag on the clamp alone: the scale is that of the tag, the tilt is left open."""
    facing = view(tilt=(0.0, 0.0), dist=(0.0,) * 5)
    rec, corners = recording(calibrated=facing), corners_of(TRUE[30:31, :1], facing)
    plane = fit_plane(corners, SIZE, rec.camera if calibrated else None, (WIDTH, HEIGHT))
    side = np.linalg.norm(np.diff(to_plane(plane.view, corners[0, 0]), axis=0), axis=1)
    assert side == pytest.approx(SIZE, rel=2e-3)
    assert np.all(np.isfinite(plane.covariance))
