"""The outline of a painted body: where its edges are known, and what is no body."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial import cKDTree

from onebend.errors import ObservationError
from onebend.recording import flanks, outline
from onebend.recording.camera import measure_tags
from onebend.recording.flanks import MEASURED, BodyPlace, Planes, Sight, Stations
from onebend.recording.plane import project, to_plane
from onebend.records import Array, BoolArray, Markers, OutlineTrack, View
from tests.recording.filmed import HEIGHT, LENGTH, WIDTH, corners_of, detections, poses, recording, view

BODY, GROUND, WALL = (200.0, 118.0, 136.0), (110.0, 131.0, 125.0), (140.0, 122.0, 133.0)
VIEW = view(dist=(-0.05, 0.02, 0.0, 0.0, 0.0))
SAMPLES = 2  # of a pixel's side
_ROWS, _COLUMNS = (((np.arange(SAMPLES * n) + 0.5) / SAMPLES - 0.5) for n in (HEIGHT, WIDTH))
PLANE = to_plane(VIEW, np.stack(np.meshgrid(_COLUMNS, _ROWS), axis=-1).reshape(-1, 2))  # m, of a picture's samples


def bends(count: int = 8, most: float = 0.25) -> Array:
    """(T,) rad of the tip."""
    return most * np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, count)) ** 2


def line(bend: float, s: Array) -> tuple[Array, Array]:
    """The body's middle (n, 2) m and its angle (n,): the curvature falls to the tip."""
    fine = np.linspace(0.0, 1.0, 801)
    angle = bend * (2.0 * fine - fine**2)
    steps = np.stack([np.cos(angle), np.sin(angle)], axis=1) * LENGTH / 800
    xy = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * (steps[1:] + steps[:-1]), axis=0)])
    return np.stack([np.interp(s, fine, one) for one in xy.T], axis=1), np.interp(s, fine, angle)


def half_width(s: Array) -> Array:
    """m, of a body that tapers."""
    return np.asarray(0.007 - 0.0015 * s)


@cache
def painted(
    bend: float, *, wall: float = 0.0, ends: float = 1.0, rim: float = 0.0, noise: float = 1.5, seed: int = 0
) -> Planes:
    """A picture of the body up to s = `ends`, with a wall of this width [m] on its left, blurred by a pixel; the outer
    two fifths of its width are darker by `rim`."""
    s = np.linspace(0.0, ends, 600)
    middle, angle = line(bend, s)
    near = np.flatnonzero(np.all((middle.min(axis=0) - 0.015 < PLANE) & (middle.max(axis=0) + 0.015 > PLANE), axis=1))
    distance, best = cKDTree(middle).query(PLANE[near], distance_upper_bound=0.015)
    best = np.minimum(best, len(s) - 1)
    normal = np.stack([-np.sin(angle[best]), np.cos(angle[best])], axis=1)
    off = PLANE[near] - middle[best]
    across, along = np.sum(off * normal, axis=1), s[best]
    ahead = off[:, 0] * normal[:, 1] - off[:, 1] * normal[:, 0]
    beside = np.isfinite(distance) & (np.abs(ahead) < 0.6 * ends * LENGTH / len(s))  # not beyond an end
    colour = np.tile(GROUND, (len(PLANE), 1))
    colour[near[beside & (across > 0.0) & (across < half_width(along) + wall)]] = WALL if wall else BODY
    colour[near[beside & (np.abs(across) < half_width(along))]] = BODY
    colour[near[beside & (np.abs(np.abs(across) / half_width(along) - 0.8) < 0.2)], 0] -= rim
    mean = colour.reshape(HEIGHT, SAMPLES, WIDTH, SAMPLES, 3).mean(axis=(1, 3))
    for axis in (0, 1):
        mean = 0.25 * np.roll(mean, 1, axis) + 0.5 * mean + 0.25 * np.roll(mean, -1, axis)
    seen = np.rint(mean + noise * np.random.default_rng(seed).normal(size=mean.shape)).astype(np.uint8)
    return Planes(seen[..., 0].copy(), np.moveaxis(seen[..., 1:], 2, 0).copy())


def stations_and_hidden() -> tuple[Stations, BoolArray, float]:
    """As `outline_track` has them, and px/m."""
    ends = project(VIEW, np.array([[0.0, 0.0], [LENGTH, 0.0]]))
    scale = float(np.linalg.norm(ends[1] - ends[0])) / LENGTH
    stations = Stations(LENGTH, 2 * outline.POINTS + 40)
    return stations, np.asarray(stations.s < 0.06), scale


def followed(pictures: Sequence[Planes]) -> tuple[outline.Middle, outline.OutlineSearch]:
    """The body's centreline in these pictures."""
    stations, hidden, scale = stations_and_hidden()
    sights = [Sight(one, VIEW, np.zeros(2)) for one in pictures]
    found, half = outline.follow(sights, BodyPlace("painted", VIEW, stations, hidden, math.nan))
    middle = outline.centreline(found, stations, half, MEASURED / scale)
    outline.refuse_lost(middle, found, ~hidden, "painted")
    return middle, found


def points(middle: outline.Middle, found: outline.OutlineSearch) -> OutlineTrack:
    """Its points."""
    stations, _, scale = stations_and_hidden()
    return outline.points_of(middle, found, stations, VIEW, np.zeros((len(found.away), 2)), scale)


def traced(pictures: Sequence[Planes]) -> OutlineTrack:
    """The body's points in these pictures."""
    return outline.often_seen(points(*followed(pictures)))


def errors(track: OutlineTrack, bend: Array, seen: View = VIEW) -> Array:
    """(T, n) px across the body, from where it was painted to where it was found."""
    out = []
    for t, b in enumerate(bend.tolist()):
        true = project(seen, line(b, np.linspace(0.0, 1.0, 4001))[0])
        nearest = np.argmin(np.linalg.norm(track.px[t][:, None] - true, axis=-1), axis=1)
        along = track.ahead[t] - track.px[t]
        normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
        out.append(np.sum((track.px[t] - true[nearest]) * normal, axis=1))
    return np.where(np.isfinite(track.sd), np.array(out), np.nan)


BENDS = bends()
BENT = 0.9  # rad, of the tip of a body that is bent in its first picture


@cache
def push() -> tuple[outline.Middle, outline.OutlineSearch]:
    """What is followed of one."""
    return followed([painted(b, seed=i) for i, b in enumerate(BENDS.tolist())])


def test_the_middle_lies_where_it_was_painted() -> None:
    off = errors(outline.often_seen(points(*push())), BENDS)
    assert np.isfinite(off).mean() > 0.95
    assert abs(float(np.nanmean(off))) < 0.1
    assert float(np.sqrt(np.nanmean(off**2))) < 0.15


@pytest.mark.slow
def test_a_body_that_is_bent_in_its_first_picture_is_found_from_the_clamp_on() -> None:
    bend = np.full(3, BENT)
    off = errors(traced([painted(BENT, seed=i) for i in range(3)]), bend)
    assert np.isfinite(off).mean() > 0.9
    assert float(np.sqrt(np.nanmean(off**2))) < 0.15


@pytest.mark.slow
def test_the_sd_is_that_of_the_error() -> None:
    claimed, true = [], []
    for bend in (0.1, 0.25, 0.4):
        track = traced([painted(bend, seed=50 + i) for i in range(4)])
        claimed.append(float(np.nanmedian(track.sd)))
        true.append(float(np.sqrt(np.nanmean(errors(track, np.full(4, bend)) ** 2))))
    assert 0.8 < np.mean(claimed) / np.mean(true) < 1.25


def test_the_width_is_that_of_the_body() -> None:
    stations, hidden, _ = stations_and_hidden()
    shown = ~hidden & (stations.s < 0.99)
    np.testing.assert_allclose(push()[0].width[shown], 2.0 * half_width(stations.s[shown]), atol=0.15e-3)


def test_a_wall_is_no_part_of_the_top_face() -> None:
    track = traced([painted(b, wall=0.003, seed=i) for i, b in enumerate(BENDS[:4].tolist())])
    assert abs(float(np.nanmean(errors(track, BENDS[:4])))) < 0.2


@pytest.mark.slow
def test_a_body_of_stated_width_with_a_darker_rim_is_seen_up_to_where_the_rim_ends() -> None:
    stations, hidden, _ = stations_and_hidden()
    place = BodyPlace("painted", VIEW, stations, hidden, 2.0 * float(half_width(np.zeros(()))))
    pictures = [painted(b, rim=22.0, seed=i) for i, b in enumerate(BENDS[:3].tolist())]
    found, _ = outline.follow([Sight(one, VIEW, np.zeros(2)) for one in pictures], place)
    assert np.isfinite(found.away[..., ~hidden]).mean() > 0.95
    wide = np.nanmedian(found.away[:, 0] - found.away[:, 1] - 2.0 * half_width(stations.s))
    assert abs(wide) < 0.15e-3


@pytest.mark.parametrize(("share", "told"), [(1.0, 0), (0.6, 1), (2.0, 1)])
def test_a_stated_width_finds_a_body_beside_the_axis_and_a_wrong_one_is_named(share: float, told: int) -> None:
    stations, hidden, _ = stations_and_hidden()
    true = 2.0 * float(half_width(np.array(0.06)))
    place = BodyPlace("painted", VIEW, stations, hidden, share * true)
    _, half = outline.follow([Sight(painted(0.1), VIEW, np.array([0.0, 9.0]))], place)
    assert 2.0 * half[~hidden][0] == pytest.approx(true, abs=0.2e-3)
    assert len(outline.width_remarks(place, half)) == told


def test_of_several_edges_those_that_are_as_far_apart_as_the_stated_width_are_the_bodys() -> None:
    stations, hidden, _ = stations_and_hidden()
    part, sight = ~hidden & (stations.s < 0.16), Sight(painted(0.0, rim=45.0), VIEW, np.zeros(2))
    true, curve = 2.0 * float(half_width(np.array(0.11))), stations.curve(np.zeros(1 + flanks.STATES))
    for width, share in ((math.nan, 0.6), (true, 1.0), (0.6 * true, 0.6), (3.0 * true, 0.6)):
        sides = flanks.first_width(sight, curve, part, LENGTH, width)
        assert sides.sum() == pytest.approx(share * true, rel=0.08)


def test_an_edge_between_two_levels_is_found_to_a_twentieth_of_a_pixel() -> None:
    for place in (-1.3, -0.4, 0.0, 0.3, 2.2):
        share = 0.5 + 0.5 * np.tanh((flanks.OUT - place) / 0.9)
        colour = np.stack([200.0 - 80.0 * share, 120.0 + 0.0 * share, 130.0 + 0.0 * share], axis=1)[None, None]
        first = np.full((1, 1), int(np.argmin(np.abs(flanks.OUT - place))) - 2)
        assert float(flanks.edge_place(colour.astype(np.float32), first, np.ones(3))[0, 0]) == pytest.approx(
            place, abs=0.05
        )


def with_tags(pictures: Sequence[Planes], bend: Array) -> tuple[outline.Middle, outline.OutlineSearch]:
    """The body's centreline in these pictures, in which three tags are known, a little off."""
    stations, hidden, scale = stations_and_hidden()
    s = np.array([0.35, 0.65, 0.95])
    shapes = [line(b, s) for b in bend.tolist()]
    off = 2e-4 * np.random.default_rng(0).normal(size=(1, 3, 2))
    xy, angle = np.stack([one for one, _ in shapes]) + off, np.stack([one for _, one in shapes])
    tags = Markers(
        np.arange(len(bend)) / 30.0, np.arange(3), s, xy, angle, np.tile(1e-10 * np.eye(3), (len(bend), 3, 1, 1)),
        np.zeros(len(bend)), VIEW,
    )  # fmt: skip
    sights = [Sight(one, VIEW, np.zeros(2)) for one in pictures]
    found, half = outline.with_tags(sights, stations, hidden, tags)
    return outline.centreline(found, stations, half, MEASURED / scale), found


@pytest.mark.slow
@pytest.mark.parametrize("wall", [pytest.param(0.0, marks=pytest.mark.slow), 0.003])
def test_beside_tags_the_edges_are_those_that_move_with_the_tags(wall: float) -> None:
    middle, found = with_tags([painted(b, wall=wall, seed=i) for i, b in enumerate(BENDS.tolist())], BENDS)
    off = errors(points(middle, found), BENDS)
    assert np.isfinite(off).mean() > 0.9
    assert abs(float(np.nanmean(off))) < 0.2
    assert float(np.nanstd(off)) < 0.15
    stations, hidden, _ = stations_and_hidden()
    shown = ~hidden & (stations.s < 0.99)
    np.testing.assert_allclose(middle.width[shown], 2.0 * half_width(stations.s[shown]), atol=0.3e-3)


def with_a_block(planes: Planes) -> Planes:
    """The picture with a black block to the right of the body's first third, which hardly moves there."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    xy = to_plane(VIEW, np.stack([columns, rows], axis=-1).reshape(-1, 2)).reshape(HEIGHT, WIDTH, 2)
    inside = (xy[..., 0] < 0.35 * LENGTH) & (xy[..., 1] < -0.011)
    return replace(planes, luma=np.where(inside, 10, planes.luma).astype(np.uint8))


def test_a_thing_on_one_side_of_the_body_is_no_edge_of_it() -> None:
    pictures = [with_a_block(painted(b, seed=i)) for i, b in enumerate(BENDS.tolist())]
    middle, found = with_tags(pictures, BENDS)
    assert abs(float(np.nanmean(errors(points(middle, found), BENDS)))) < 0.2
    stations, hidden, _ = stations_and_hidden()
    shown = ~hidden & (stations.s < 0.99)
    np.testing.assert_allclose(middle.width[shown], 2.0 * half_width(stations.s[shown]), atol=0.3e-3)


@pytest.mark.slow
def test_beside_tags_without_a_body_nothing_is_found() -> None:
    with pytest.raises(ObservationError, match="no two edges"):
        with_tags([painted(0.0, ends=0.02, seed=i) for i in range(len(BENDS))], BENDS)


def test_the_best_line_is_the_brightest_one_that_does_not_jump() -> None:
    worth = 0.1 * np.random.default_rng(0).random((40, 60))
    ridge = (20 + 8 * np.sin(np.arange(40) / 6.0)).astype(int)
    worth[np.arange(40), ridge] = 1.0
    worth[10:13, 55] = 1.5  # brighter, and elsewhere
    planes = np.stack([np.zeros((40, 60)), worth], axis=1)
    np.testing.assert_array_equal(outline.best_line(planes), np.stack([np.ones(40), ridge], axis=1))


def test_both_flanks_tell_the_error_of_their_middle_and_how_long_it_lasts() -> None:
    rng, rho = np.random.default_rng(0), 0.8
    white = rng.normal(size=(2, 4000, 20))
    flanks = lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], white, axis=1)
    found = outline.lasting_sd(flanks[0] - flanks[1])
    middle_sd, time = outline.SHARED * np.sqrt(0.5), (1.0 + rho) / (1.0 - rho)
    np.testing.assert_allclose(np.mean(found), middle_sd * np.sqrt(time), rtol=0.1)
    one_alone = np.where(np.arange(20) == 3, np.nan, flanks[0] - flanks[1])
    np.testing.assert_array_equal(np.isnan(outline.lasting_sd(one_alone)), np.arange(20) == 3)


def test_without_a_body_nothing_is_traced() -> None:
    plain = painted(0.0, ends=0.02)
    with pytest.raises(ObservationError, match="no body is seen beside the clamp"):
        traced([plain])


@pytest.mark.slow
def test_a_body_that_ends_before_its_tip_is_refused() -> None:
    with pytest.raises(ObservationError, match=r"outline is lost|before its tip|no body|leaves the body"):
        traced([painted(b, ends=0.7, seed=i) for i, b in enumerate(BENDS[:3].tolist())])


def test_pictures_without_the_body_are_left_out_and_told() -> None:
    pictures = [painted(0.01 * i, seed=i) for i in range(4)]
    pictures[2] = painted(0.0, ends=0.02)
    stations, hidden, _ = stations_and_hidden()
    found, _ = outline.follow(
        [Sight(one, VIEW, np.zeros(2)) for one in pictures], BodyPlace("painted", VIEW, stations, hidden, math.nan)
    )
    lost = ~np.isfinite(found.away).any(axis=(1, 2))
    assert lost.tolist() == [False, False, True, False]
    (remark,) = outline.lost_remarks(found)
    assert "1 of 4 frames" in remark.text


@pytest.mark.slow
def test_a_body_that_moved_on_while_it_was_hidden_is_found_again() -> None:
    pictures = [painted(0.0), painted(0.0, ends=0.02, seed=1), *(painted(BENT + 0.1 * i, seed=2 + i) for i in range(3))]
    stations, hidden, _ = stations_and_hidden()
    found, _ = outline.follow(
        [Sight(one, VIEW, np.zeros(2)) for one in pictures], BodyPlace("painted", VIEW, stations, hidden, math.nan)
    )
    lost = ~np.isfinite(found.away).any(axis=(1, 2))
    assert lost.tolist() == [False, True, False, False, False]


def test_a_curve_off_the_body_is_refused() -> None:
    stations, hidden, scale = stations_and_hidden()
    sights = [Sight(painted(0.3), VIEW, np.zeros(2))] * 3
    found, half = outline.follow(sights, BodyPlace("painted", VIEW, stations, hidden, math.nan))
    rng = np.random.default_rng(1)
    strayed = outline.OutlineSearch(found.state, found.away + 3e-3 * rng.normal(size=found.away.shape))
    middle = outline.centreline(strayed, stations, half, MEASURED / scale)
    with pytest.raises(ObservationError, match=r"leaves the body|lost"):
        outline.refuse_lost(middle, strayed, ~hidden, "painted")


def beside_tags(*, off: float = 0.0, drift: float = 0.0, most: float = 0.25, gap: float = 0.0) -> Markers:
    """A body that bends by `most` rad, with points of its outline and a tag `off` m to its left, against which the line
    moves by `drift` m while the body bends; no points in a `gap` behind the tag."""
    s, every = np.linspace(0.05, 0.95, 19), bends(most=most)
    s = np.sort(np.append(s[(s < 0.52) | (s > 0.52 + gap)], 0.52))
    tag = s == 0.52
    shapes = [line(bend, s) for bend in every]
    xy, angle = np.stack([one for one, _ in shapes]), np.stack([one for _, one in shapes])
    left = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
    xy = xy + np.where(tag, off, 0.0)[:, None] * left
    xy = xy + np.where(tag, 0.0, drift)[:, None] * left * (every / every.max())[:, None, None]
    covariance = np.broadcast_to(1e-10 * np.eye(3), (*angle.shape, 3, 3))
    return Markers(
        np.arange(len(every)) / 30.0, np.arange(len(s)), s, xy, angle, covariance, np.zeros(len(every)), VIEW,
        traced=~tag,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("off", "drift", "said"),
    [(0.0, 0.0, ""), (5e-4, 1e-4, ""), (2e-3, 0.0, ""), (3e-3, 0.0, "passes 3 mm"), (0.0, 3e-3, "moves by up to")],
)
def test_an_outline_that_contradicts_a_tag_is_told(off: float, drift: float, said: str) -> None:
    assert said in (found := outline.contradicted(beside_tags(off=off, drift=drift), recording()))
    assert bool(found) == bool(said)


def test_a_tag_at_the_edge_of_a_gap_is_not_contradicted_by_the_chord_over_it() -> None:
    assert not outline.contradicted(beside_tags(most=1.2, gap=0.2), recording())


def test_beside_tags_a_body_that_is_not_found_is_left_out_with_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: object, **__: object) -> OutlineTrack:
        raise ObservationError("a film: no body is seen. Light it.")

    monkeypatch.setattr(outline, "outline_track", lost)
    rec, corners = recording(), corners_of(poses(12), view())
    seen, number = detections(corners), np.arange(12)
    tags = measure_tags(seen, rec)
    markers = tags.markers()
    left = outline.with_outline(tags, markers, number)
    assert left.traced is None
    assert [one.text for one in left.remarks if one not in markers.remarks] == [
        "The body's outline is not used beside the tags: a film: no body is seen."
    ]
    bare = replace(rec, tags=replace(rec.tags, on_beam=()))
    with pytest.raises(ObservationError, match="no body is seen"):
        outline.with_outline(replace(tags, description=bare), markers, number)


def test_between_the_frames_that_are_read_the_curve_is_not_seen() -> None:
    rng, kept = np.random.default_rng(0), np.array([0, 3, 6])
    of_kept = OutlineTrack(np.array([0.2, 0.8]), rng.random((3, 2, 2)), rng.random((3, 2, 2)), np.ones((3, 2)))
    spread = outline.spread_over(of_kept, kept, 8)
    np.testing.assert_allclose(spread.px[kept], of_kept.px)
    np.testing.assert_allclose(spread.px[4], (2.0 * of_kept.px[1] + of_kept.px[2]) / 3.0)
    np.testing.assert_allclose(spread.ahead[7], of_kept.ahead[2])
    assert np.array_equal(np.flatnonzero(np.isfinite(spread.sd[:, 0])), kept)


def dotted(planes: Planes, bend: float, radius: float) -> Planes:
    """The picture with black dots of this radius [m] on the body's middle."""
    middle, _ = line(bend, np.array([0.25, 0.5, 0.75]))
    away = to_plane(VIEW, np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1)) - middle[:, None, None]
    black = np.linalg.norm(away, axis=-1).min(axis=0) < radius
    luma, chroma = np.where(black, 20, planes.luma), np.where(black, 128, planes.chroma)
    return Planes(luma.astype(np.uint8), chroma.astype(np.uint8))


@pytest.mark.slow
def test_dots_on_the_body_do_not_move_its_middle() -> None:
    pictures = [dotted(painted(b, seed=i), b, 0.003) for i, b in enumerate(BENDS.tolist())]
    off = errors(traced(pictures), BENDS)
    assert np.isfinite(off).mean() > 0.95
    assert float(np.nanmax(np.sqrt(np.nanmean(off**2, axis=0)))) < 0.15
