"""A push followed live: nothing that is lost, late or doubled stops it, no state depends on what comes later, what is
kept is bounded, and after the last frame k(s) has the band that `learn` gives."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from onebend.errors import ObservationError, RecordingError
from onebend.learning.optimizer import FitSettings
from onebend.live.live import Live, LiveSettings, LiveState
from onebend.live.review import ENDED, Reviewed, ReviewerBeside, Seen, review
from onebend.pipeline import learn, learn_observed
from onebend.recording.camera import measure_markers
from onebend.recording.entries import GravityEntry
from onebend.recording.force import read_log
from onebend.recording.observe import observe_markers
from onebend.recording.tag_finder import Finder
from onebend.recording.tags import in_blocks, track_block
from onebend.recording.video import read_frames
from onebend.records import Detections
from tests.live.disturbed import Arrival, Disturbances, play
from tests.live.followed import Followed, follow
from tests.live.streamed import BEAM, OFFSET, described, frames, log

pytestmark = pytest.mark.usefixtures("no_other_places")

S = np.linspace(0.05, 0.9, 30)
HERE = LiveSettings(first_review=4.0, review_growth=2.0)  # one review, in the middle of the push
NEVER = LiveSettings(first_review=np.inf)
QUICK = FitSettings(functions=16, most_frames=60, first_frames=40)
ROUGH = Disturbances(
    frames_lost=0.05,
    frames_late=0.05,
    frames_twice=0.05,
    frame_jitter=1e-4,
    samples_lost=0.05,
    samples_late=0.2,
    samples_twice=0.1,
    samples_nan=0.05,
    sample_jitter=1e-4,
    samples_each=3,
)


@cache
def disturbed() -> tuple[Live, Followed, LiveState]:
    """The push with all that can happen to it on its way."""
    live = Live(described(), settings=HERE, beside=False)
    followed = follow(live, _broken(play(frames(), log(), OFFSET, ROUGH, seed=1)))
    return live, followed, live.state()


def _broken(arrivals: Iterable[Arrival]) -> Iterator[Arrival]:
    """Every twentieth thing is followed by one of no use."""
    for i, arrival in enumerate(arrivals):
        yield arrival
        if i % 20 == 0 and arrival.picture is not None:
            yield replace(arrival, stamp=np.array(np.nan))
            yield replace(arrival, picture=np.zeros((4, 4, 3), np.uint8))
            yield replace(arrival, stamp=arrival.stamp + 1e-3, picture=arrival.picture[:-2])
        elif i % 20 == 0:
            yield replace(arrival, stamp=np.full(len(arrival.stamp), np.nan))


@pytest.mark.slow
def test_nothing_that_is_lost_late_or_doubled_stops_it() -> None:
    _, followed, state = disturbed()
    counts = state.counts
    assert min(counts.late_frames, counts.refused_frames, counts.late_samples, counts.refused_samples) > 0
    assert counts.learned_frames > 4
    assert state.clock is not None
    assert abs(state.clock.offset - OFFSET) < 4 * state.clock.sd < 0.1
    assert state.stiffness is not None
    band = state.stiffness.band(S)
    assert np.mean((band.low < 0.02) & (band.high > 0.02)) > 0.9
    assert np.mean(band.identified) > 0.8
    assert state.verdict.grade == "not yet"
    assert "±" in state.verdict.known
    assert "let go" in state.verdict.next
    assert any("drift" in words for words in state.waiting)
    latency = followed.latency[np.isfinite(followed.latency)]
    assert len(latency) > 10
    assert np.max(latency[-3:]) < 0.1  # those before waited for the review, which this process made


def test_after_the_last_frame_the_band_is_that_of_learn() -> None:
    """Of the same film and log, undisturbed, read as a recording is."""
    rec = described(OFFSET, 0.0)
    live = Live(rec, settings=NEVER, beside=False)
    follow(live, play(frames(), log(), OFFSET, ROUGH, seed=1))
    run = live.finish(fitting=QUICK)
    assert run.posterior is not None
    assert run.posterior.grade in ("holds", "holds with allowances")
    film, finder = frames(), Finder("tag36h11")
    corners = np.concatenate([track_block(part, range(4), finder).corners for part in in_blocks(film, 32)])
    found = Detections(np.array([one.time for one in film]), np.arange(4), corners, *film[0].luma.shape[::-1])
    whole = learn_observed(observe_markers(rec, measure_markers(found, rec), log()), fitting=QUICK).posterior
    assert whole is not None
    (here, sd), (there, batch_sd) = run.posterior.stiffness.log_at(S), whole.stiffness.log_at(S)
    assert abs(np.median(sd / batch_sd) - 1.0) < 0.25  # of other frames
    assert np.sqrt(np.mean(((here - there) / batch_sd) ** 2)) < 0.8
    with pytest.raises(ObservationError, match="finished"):
        live.frame(film[0].luma, 9.0)


@pytest.mark.slow
def test_no_state_depends_on_what_comes_later() -> None:
    until = 4.6  # s, after the review
    same = [arrival for arrival in play(frames(), log(), OFFSET) if arrival.at < until]
    more = [arrival for arrival in play(frames(), log(), OFFSET) if arrival.at >= until]
    cut, whole = (Live(described(), settings=HERE, beside=False) for _ in range(2))
    follow(cut, same)
    follow(whole, same)
    one = whole.state()
    follow(whole, more)
    other = cut.state()
    assert one.stiffness is not None
    assert other.stiffness is not None
    assert np.array_equal(one.stiffness.mean, other.stiffness.mean)
    assert np.array_equal(one.force, other.force)
    assert one.counts == other.counts


@pytest.mark.slow
def test_what_is_kept_is_bounded_however_long_it_runs() -> None:
    settings = replace(NEVER, most_frames=40, most_rows=200)
    live, film, force = Live(described(), settings=settings, beside=False), frames(), log()
    most: dict[str, int] = {}
    for i in range(5):
        later = [replace(one, time=one.time + 7.0 * i) for one in film]
        for arrival in play(later, replace(force, time=force.time + 7.0 * i), OFFSET):
            follow(live, [arrival])
            kept = {
                "frames": live._frames.frames,
                "pictures": live._pictures.by_time(),
                "rows": live._log.rows,
                "tracker": live._tracker._tags._rows,
                "since": live._following._since,
            }
            most = {name: max(len(every), most.get(name, 0)) for name, every in kept.items()}
    assert live.state().counts.samples == 5 * len(force.time)
    assert 0 < most.pop("pictures") <= 10
    assert most == {"frames": 40, "rows": 200, "tracker": 8, "since": 40}


def test_what_is_not_known_yet_is_said() -> None:
    live = Live(described(), settings=LiveSettings(first_review=0.9), beside=False)
    first = live.state()
    assert first.verdict.headline == "k(s) is not identifiable yet: no frame has come yet"
    assert (first.stiffness, first.clock) == (None, None)
    assert np.isnan(first.force).all()
    for frame in frames()[:15]:
        live.frame(frame.luma, frame.time)
    assert "0 samples of the force" in live.state().verdict.headline
    live.force(log().time[:160], log().force[:160])
    for frame in frames()[15:18]:
        live.frame(frame.luma, frame.time + 1.0)
    state = live.state()
    assert "has not moved yet" in state.verdict.headline
    assert state.verdict.next == "keep the beam at rest for three seconds, then push it slowly"
    live.frame(np.zeros((360, 640, 3), np.uint8), 3.0)
    assert any("must be a grey array" in words for words in live.state().waiting)
    dark = Live(described(), settings=LiveSettings(first_review=0.1), beside=False)
    for i in range(4):
        dark.frame(np.zeros((360, 640), np.uint8), i / 10)
    assert dark.state().verdict.next == "bring all tags into the picture, in focus and well lit"


@pytest.mark.slow
def test_one_clock_for_both_is_stated_in_their_own_times() -> None:
    shift = 1.7e9  # s since 1970
    live = Live(described(np.nan, np.inf), clock=(0.0, 0.01), settings=HERE, beside=False)
    later = [replace(one, time=one.time + shift + OFFSET) for one in frames()[:70]]
    follow(live, play(later, replace(log(), time=log().time + shift), 0.0))
    state = live.state()
    assert state.clock is not None
    assert state.clock.stated == pytest.approx(0.0, abs=1e-6)
    assert abs(state.clock.offset) < 0.02
    assert state.time == later[-1].time


@pytest.mark.slow
def test_what_the_live_learner_does_not_know_waits_for_the_end() -> None:
    rec = described(OFFSET, 0.0)
    for other, words in (
        (replace(rec, beam=replace(rec.beam, stiffness_along="even")), "stiffness_along"),
        (replace(rec, force=None, push=None), "no [force]"),
    ):
        live = Live(other, settings=LiveSettings(first_review=3.0, review_growth=9.0), beside=False)
        for arrival in play(frames()[:60], log(), OFFSET):
            if arrival.picture is not None:
                live.frame(arrival.picture, float(arrival.stamp))
            else:
                live.force(arrival.stamp, arrival.rows)
        headline = live.state().verdict.headline
        assert words in headline


def test_what_cannot_be_followed_is_refused() -> None:
    rec = described()
    with pytest.raises(RecordingError, match=r"needs \[video\]"):
        Live(replace(rec, video=None))
    with pytest.raises(RecordingError, match="base_angle_file"):
        Live(replace(rec, gravity=GravityEntry(0.0, base_angle_file=Path("base.csv"))))
    live = Live(rec, beside=False)
    for wrong in (([0.0, 1.0], [0.1, 0.2]), (0.0, [0.1, 0.2, 0.3]), (0.0, 0.1)):
        with pytest.raises(ObservationError, match="samples of the force are"):
            live.force(*wrong)
    live.force(0.0, (0.1, 0.2))
    with pytest.raises(ObservationError, match="no frame has come yet"):
        live.finish()


def test_the_files_of_a_recording_to_come_need_not_be_there(tmp_path: Path) -> None:
    text = """format = 1
[beam]
length_m = 0.15
[tags]
size_m = 0.012
on_base = [{ id = 0, s = 0.0 }]
on_beam = [{ id = 1, s = 0.5 }, { id = 2, s = 1.0 }]
[video]
file = "video.mp4"
[force]
file = "force.csv"
[push]
at_s = 1.0
"""
    (tmp_path / "recording.toml").write_text(text, encoding="utf-8")
    with Live(tmp_path, beside=False) as live:
        assert live.recording.force is not None
    with pytest.raises(RecordingError, match="there is no file"):
        learn(tmp_path)


@pytest.mark.slow
def test_a_process_beside_finds_what_this_one_does_and_may_end() -> None:
    seen, settings = _half(), (HERE.observing, HERE.learning)
    beside = ReviewerBeside(*settings)
    beside.begin(seen)
    here, there = review(seen, *settings), _waited_for(beside)
    assert here.learner is not None
    assert there.learner is not None
    assert there.until == here.until == seen.until
    assert np.allclose(there.learner.stiffness.mean, here.learner.stiffness.mean, rtol=1e-6, atol=1e-8)
    beside.begin(seen)
    os.kill(beside._process.pid, signal.SIGKILL)
    assert _waited_for(beside).why == ENDED
    assert not beside.busy
    beside.close()


def _half() -> Seen:
    """The push up to its middle."""
    live = Live(described(), settings=NEVER, beside=False)
    for arrival in play(frames()[:55], log(), OFFSET):
        if arrival.picture is None:
            live.force(arrival.stamp, arrival.rows)
        elif arrival.at < 3.2:
            live.frame(arrival.picture, float(arrival.stamp))
    return live._seen()


def _waited_for(beside: ReviewerBeside) -> Reviewed:
    deadline = time.monotonic() + 120.0
    while time.monotonic() < deadline:
        if (made := beside.result()) is not None:
            return made
        time.sleep(0.01)
    raise AssertionError("the process beside did not answer")


DEVELOPMENT = Path(__file__).parents[3] / "shared" / "recordings"
KINDS = ("train", "fast", "s08", "s06")


@pytest.mark.slow
@pytest.mark.skipif(not DEVELOPMENT.is_dir(), reason="the development recordings are not here")
@pytest.mark.parametrize("name", [f"{beam}_{kind}" for beam in ("linear", "quadratic", "cubic") for kind in KINDS])
def test_the_band_of_the_development_recordings_is_that_of_learn(name: str) -> None:
    run = learn(DEVELOPMENT / name)
    live = Live(DEVELOPMENT / name, settings=NEVER, beside=False)
    video, force, clock = live.recording.video, read_log(live.recording), run.recordings[0].source.clock
    assert video is not None
    assert force is not None
    assert clock is not None
    follow(live, play(read_frames(video), force, clock.offset))
    here, there = live.finish().posterior, run.posterior
    assert here is not None
    assert there is not None
    assert abs(np.median(here.stiffness.log_at(S)[1] / there.stiffness.log_at(S)[1]) - 1.0) < 0.15
    assert BEAM.length == here.beam.length
