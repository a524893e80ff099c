"""A body without tags on it, followed live by its outline."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial import cKDTree

from onebend.live.body import NOT_SEEN, BodyFrame, BodyTracker, curve_in
from onebend.live.guidance import CaptureSettings, Stages
from onebend.live.live import Live, LiveSettings
from onebend.live.review import observed_in
from onebend.recording.entries import Recording
from onebend.recording.plane import project, to_plane
from onebend.recording.video import FilmFrame, Picture
from onebend.records import Array
from tests.live.disturbed import play
from tests.live.followed import follow
from tests.live.streamed import BEAM, DURATION, OFFSET, described, force_at, log
from tests.recording.filmed import HEIGHT, LENGTH, WIDTH, picture, view

pytestmark = pytest.mark.usefixtures("no_other_places")

FPS, HALF_WIDTH, LEVEL = 12.0, 0.006, 205.0
S = np.linspace(0.1, 0.9, 30)


def bare() -> Recording:
    """What recording.toml would say of a body with a tag at its clamp alone."""
    rec = described(OFFSET, 0.0)
    return replace(rec, tags=replace(rec.tags, on_beam=()))


@cache
def ground() -> tuple[Array, Array]:
    """The picture without a body, and the places (H W, 2) m of its pixels."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    return picture(np.zeros((1, 3)), [0], view()), to_plane(view(), np.stack([columns, rows], axis=-1).reshape(-1, 2))


def painted(middle: Array | None, seed: int, tags: Array | None = None) -> Picture:
    """A picture of a body with this middle line (n, 2) m, and with tags (3, 3) m, m, rad on it."""
    empty, xy = ground()
    mean = empty.copy()
    if middle is not None:
        beside = 2.0 * HALF_WIDTH
        near = np.all((xy > np.min(middle, axis=0) - beside) & (xy < np.max(middle, axis=0) + beside), axis=1)
        away = np.full(len(xy), np.inf)
        away[near] = cKDTree(middle).query(xy[near], distance_upper_bound=beside)[0]
        body = np.clip(0.5 + (HALF_WIDTH - away) * WIDTH / 0.26, 0.0, 1.0).reshape(HEIGHT, WIDTH)
        body[np.hypot(*xy.T).reshape(HEIGHT, WIDTH) < 0.012] = 0.0  # the tag lies on it
        mean = (1.0 - body) * empty + body * LEVEL
    if tags is not None:
        shown = picture(np.concatenate([np.zeros((1, 3)), tags]), range(4), view())
        mean = np.where(np.abs(shown - empty) > 1.0, shown, mean)
    noise = 1.5 * np.random.default_rng(seed).standard_normal(mean.shape)
    return np.clip(np.rint(mean + noise), 0, 255).astype(np.uint8)


@cache
def frames(*, tagged: bool = False) -> tuple[FilmFrame, ...]:
    """The push of `streamed`, of a body without tags or with them."""
    time = np.arange(0.0, DURATION, 1.0 / FPS)
    shape, s = BEAM.equilibrium(force_at(time)), np.array([1.0, 2.0, 3.0]) / 3.0
    lines = shape.xy(np.linspace(0.0, 1.0, 400))
    tags = np.concatenate([shape.xy(s), shape.angle(s)[..., None]], axis=-1)
    drawn = (painted(lines[t], t, tags[t] if tagged else None) for t in range(len(time)))
    return tuple(FilmFrame(t, float(time[t]), one) for t, one in enumerate(drawn))


@cache
def followed() -> Live:
    live = Live(bare(), settings=LiveSettings(first_review=4.0, review_growth=2.0), beside=False)
    follow(live, play(frames(), log(), OFFSET))
    return live


def test_k_is_learned_from_the_outline() -> None:
    state = followed().state()
    assert state.stiffness is not None, state.waiting
    band = state.stiffness.band(S)
    assert np.mean((band.low <= 0.02) & (band.high >= 0.02)) > 0.9
    assert np.sqrt(np.mean((band.k / 0.02 - 1.0) ** 2)) < 0.15
    assert state.counts.learned_frames > 4  # one by one, after the review


@pytest.mark.slow
def test_beside_tags_both_are_learned_from() -> None:
    live = Live(described(), settings=LiveSettings(first_review=4.0, review_growth=2.0), beside=False)
    follow(live, play(frames(tagged=True), log(), OFFSET))
    learning = live._following.learning
    assert learning is not None
    assert learning.learned > 4  # one by one, after the review
    m = learning.reader.traced
    assert 3 == np.sum(~m) < 15 < np.sum(m)
    edges = [one.name for one in learning.learner.nuisances() if "edges lie off" in one.name]
    assert len(edges) == 2
    assert any(one.name.startswith("discrepancy tag") for one in learning.learner.nuisances())
    band = learning.learner.stiffness.band(S)
    assert np.mean((band.low <= 0.02) & (band.high >= 0.02)) > 0.9
    # Few pictures of tags of 30 px leave their heights open.
    assert np.sqrt(np.mean((band.k / 0.02 - 1.0) ** 2)) < 0.15
    seen = observed_in(live._seen())
    frame = learning.reader.frame(seen.time[40] - learning.reader.offset, live._frames.frames[40], np.zeros(2))
    assert frame is not None
    np.testing.assert_allclose(frame.xy[~m], seen.xy[40][~m], atol=1e-4)  # in the order of their places
    assert np.isnan(frame.xy[m]).all()


@pytest.mark.slow
def test_what_is_reviewed_is_what_a_film_of_it_shows() -> None:
    """Points of the outline at the true places, to parts of a pixel of 0.4 mm."""
    seen = observed_in(followed()._seen())
    assert seen.traced is not None
    assert seen.traced.all()
    true = BEAM.equilibrium(force_at(seen.time - OFFSET)).xy(seen.marker_s)
    slope = np.gradient(true, axis=1)
    normal = np.stack([-slope[..., 1], slope[..., 0]], axis=-1) / np.linalg.norm(slope, axis=-1, keepdims=True)
    across = np.sum((seen.xy - true) * normal, axis=-1)
    moved = across - np.nanmean(across[seen.time - OFFSET < 1.0], axis=0)
    assert np.nanmedian(np.abs(moved)) < 0.1e-3


@pytest.mark.slow
def test_the_followed_outline_is_drawn_along_the_middle_of_the_body() -> None:
    tracker = BodyTracker(bare())
    assert len(curve_in(tracker.step(painted(None, 1), 0.0))) == 0
    tracker = BodyTracker(bare())
    for one in frames()[:40]:
        drawn = curve_in(tracker.step(one.luma, one.time))
    line = BEAM.equilibrium(force_at(np.array([frames()[39].time]))).xy(np.linspace(0.0, 1.0, 400))[0]
    seen = np.isfinite(drawn).all(axis=1) & (np.arange(len(drawn)) < len(drawn) - 1)  # the tip is round
    assert 0.7 < np.mean(seen) < 1.0  # not beneath the tag at the clamp
    assert np.max(cKDTree(project(view(), line)).query(drawn[seen])[0]) < 1.0  # px


@pytest.mark.slow
def test_places_tell_how_far_the_body_moved() -> None:
    tracker, stages = BodyTracker(bare()), Stages(bare(), CaptureSettings(rest=0.5, tare=0.3), forced=False)
    for one in frames():
        seen = tracker.step(one.luma, one.time)
        assert isinstance(seen, BodyFrame)
        stages.update(one.time, seen.corners, seen.places)
    tip = BEAM.equilibrium(force_at(np.array([0.5 * DURATION]))).xy(np.ones(1))[0, 0] / LENGTH
    assert stages.largest == pytest.approx(float(np.hypot(tip[0] - 1.0, tip[1])), abs=0.01)
    assert stages.stage == "last rest"


def test_a_picture_without_the_body_says_so() -> None:
    tracker = BodyTracker(bare())
    assert tracker.why == NOT_SEEN
    assert getattr(tracker.step(painted(None, 1), 0.0), "outline", 1) is None
    assert "no body is seen beside the clamp" in tracker.why
    line = BEAM.equilibrium(force_at(np.zeros(1))).xy(np.linspace(0.0, 1.0, 400))[0]
    tracker.step(painted(line, 2), 0.1)
    assert tracker.follower is None  # it is looked for again after a while
    tracker.step(painted(line, 3), 1.0)
    assert tracker.why == ""
    tracker.step(painted(None, 4), 1.1)
    assert tracker.why == NOT_SEEN
