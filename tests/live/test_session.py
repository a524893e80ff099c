"""A push that is played, recorded: the folder is one that can be checked and learned from, whatever happened."""

from __future__ import annotations

import csv
import errno
import threading
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from onebend.errors import RecordingError
from onebend.live import recording_folder as capture_folder
from onebend.live.guidance import STAGES, CaptureOutcome, CaptureState
from onebend.live.played import PlayedCamera, PlayedForce
from onebend.live.recording_folder import FilmWriter
from onebend.live.session import record
from onebend.live.sources import Clock, End, Frame, HostClock, PlayedClock, Samples, StampTiming, measurable
from onebend.pipeline import learn
from onebend.recording.folder import read_recording
from onebend.recording.force import read_log
from onebend.recording.video import Picture, read_frames
from onebend.records import Array
from onebend.report.overview import overview
from tests.live.played_push import FORCE_CLOCK, ROUGH, SETTINGS, camera, folder, force, recorded
from tests.live.streamed import DURATION, OFFSET, force_at, frames, log


def column(path: Path, name: str) -> Array:
    with path.open(encoding="utf-8") as stream:
        return np.array([float(row[name] or "nan") for row in csv.DictReader(stream)])


def frames_in(path: Path) -> int:
    """Frames of a film that can be read to its end, beside a log that can be read."""
    rec = read_recording(path)
    assert read_log(rec) is not None
    assert rec.video is not None
    return len(list(read_frames(rec.video)))


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> tuple[CaptureOutcome, list[CaptureState]]:
    """The push recorded with nothing in its way."""
    return recorded(tmp_path_factory.mktemp("clean") / "push")


Clean = tuple[CaptureOutcome, list[CaptureState]]


def test_a_push_is_recorded_from_rest_to_rest(clean: Clean) -> None:
    outcome, states = clean
    assert outcome.whole
    assert not outcome.fault
    assert outcome.why == "the beam is at rest again after the push"
    stages = [state.stage for state in states]
    order = [STAGES.index(stage) for stage in stages]
    assert order == sorted(order)
    assert set(stages) == set(STAGES)
    assert outcome.state.frames == pytest.approx(15 * DURATION, abs=15)
    assert outcome.state.drops == 0
    assert states[-1].tags[3].seen
    assert 0.0 < outcome.state.largest < 1.0


@pytest.mark.slow
def test_check_accepts_what_was_recorded(clean: Clean) -> None:
    found = overview(clean[0].folder)
    assert found.faults == ()
    assert not [remark for remark in found.remarks if remark.doubt]


@pytest.mark.parametrize("seed", range(2))
def test_drops_and_jitter_are_borne_and_both_are_on_one_clock(tmp_path: Path, seed: int) -> None:
    outcome, _ = recorded(tmp_path / "push", how=ROUGH, seed=seed)
    rec = read_recording(tmp_path / "push")
    assert rec.video is not None
    assert outcome.state.drops > 0
    film = np.array([frame.time for frame in read_frames(rec.video)])
    stamps = column(tmp_path / "push" / "frames.csv", "stamp_s")
    assert film == pytest.approx(stamps - stamps[0], abs=2e-6)
    log = read_log(rec)
    assert log is not None
    own = column(tmp_path / "push" / "force.csv", "own_s")
    true = (own - FORCE_CLOCK.offset) / (1.0 + FORCE_CLOCK.drift) * (1.0 + 6e-5)  # on the camera's clock
    first = frames()[int(column(tmp_path / "push" / "frames.csv", "number")[0])].time * (1.0 + 6e-5)
    away = column(tmp_path / "push" / "force.csv", "time_s") - (true - first)
    assert np.abs(away).max() < 0.002


def test_the_force_is_logged_as_it_came(clean: Clean) -> None:
    path = clean[0].folder / "force.csv"
    time, force_y = column(path, "time_s"), column(path, "fy_N")
    assert np.all(np.diff(time) > 0.0)
    assert np.abs(force_y + 0.05 - force_at(time)[:, 1]).max() < 0.01


@pytest.mark.slow
def test_the_band_learned_is_like_that_of_the_original(tmp_path: Path) -> None:
    outcome, _ = recorded(tmp_path / "push", replace(SETTINGS, follow=True), ROUGH)
    assert outcome.state.stiffness is not None
    again, _ = recorded(tmp_path / "clean")
    s = np.linspace(0.0, 0.8, 9)
    fits = [learn(tmp_path / name).posterior for name in ("push", "clean")]
    bands = [fit.stiffness.band(s) for fit in fits if fit is not None]
    widths = [np.log(band.high / band.low) for band in bands]
    assert np.median(widths[0] / widths[1]) == pytest.approx(1.0, abs=0.25)
    assert np.mean((bands[0].low < 0.02) & (bands[0].high > 0.02)) > 0.8
    assert again.whole


@pytest.mark.slow
def test_a_wanted_band_that_is_not_reached_asks_for_another_push(tmp_path: Path) -> None:
    outcome, states = recorded(tmp_path / "push", replace(SETTINGS, until=0.05))
    assert not outcome.whole
    assert states[-1].stage == "last rest"
    assert states[-1].advice[0].startswith("push again")


def test_it_stops_when_told_and_says_what_is_missing(tmp_path: Path) -> None:
    stop = threading.Event()

    def watch(state: CaptureState) -> None:
        if state.stage == "push" and state.seconds > 2.5:
            stop.set()

    outcome = record(folder(tmp_path), camera(), force(), SETTINGS, watch, stop, clock=PlayedClock())
    assert (outcome.why, outcome.fault) == ("it was stopped", False)
    assert outcome.remarks[0] == "it ends before the last rest: the drift of the force does not show"
    assert frames_in(tmp_path) == outcome.state.frames


class Unplugged:
    """A sensor whose cable is pulled."""

    def __init__(self, at: float) -> None:
        self._inner, self._at = force(), at
        self.name, self.timing, self.columns = "the sensor", self._inner.timing, self._inner.columns

    def open(self, clock: Clock) -> None:
        self._inner.open(clock)

    def due(self) -> float:
        return self._inner.due()

    def read(self, wait: float) -> Samples | End | None:
        got = self._inner.read(wait)
        return End("the sensor's cable was pulled", fault=True) if self._inner.due() > 500.0 + self._at else got

    def close(self) -> None:
        self._inner.close()


def test_a_pulled_cable_leaves_what_there_is(tmp_path: Path) -> None:
    outcome = record(folder(tmp_path), camera(), Unplugged(3.0), SETTINGS, clock=PlayedClock(500.0))
    assert (outcome.why, outcome.fault) == ("the sensor's cable was pulled", True)
    assert frames_in(tmp_path) == outcome.state.frames
    assert outcome.state.frames > 30


def test_a_film_with_a_log_that_tells_nothing_is_a_fault(tmp_path: Path) -> None:
    """As of a sensor that is switched on and never sends; `check` says the same."""
    never = PlayedForce(log(), OFFSET - 500.0)
    outcome = record(folder(tmp_path), camera(), never, replace(SETTINGS, begin_at_once=True), clock=PlayedClock())
    assert outcome.fault
    with pytest.raises(RecordingError) as refused:
        read_log(read_recording(tmp_path))
    assert f"nothing can be learned from the log: {refused.value}" in outcome.why
    assert outcome.state.frames > 80


@pytest.mark.slow
def test_numbers_beyond_all_measures_are_left_out_and_counted(tmp_path: Path) -> None:
    sent = log()
    strong, odd = sent.force.copy(), np.arange(5, len(sent.time), 40)
    strong[odd, 0] = np.resize([1e31, -np.inf, 1e200], len(odd))
    sensor = PlayedForce(replace(sent, force=strong), OFFSET)
    outcome = record(folder(tmp_path), camera(), sensor, SETTINGS, clock=PlayedClock())
    assert not outcome.fault
    assert 10 <= outcome.state.lost_samples <= len(odd)  # it ends with the last rest
    logged = read_log(read_recording(tmp_path))
    assert logged is not None
    assert np.abs(logged.force).max() < 10.0


def test_a_stamp_beyond_all_times_is_left_out() -> None:
    got = measurable(Samples(np.array([1.0, 1e300, np.nan, np.inf]), np.zeros((4, 2)), 0.0, lost=1))
    assert got.stamp == pytest.approx([1.0, np.nan], nan_ok=True)
    assert (len(got.force), got.lost) == (2, 3)


def test_a_full_disk_leaves_what_there_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, count = FilmWriter.write, [0]

    def write(self: FilmWriter, picture: Picture, time: float, colour: object = None) -> bool:
        count[0] += 1
        if count[0] > 40:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(self, picture, time, colour)

    monkeypatch.setattr(FilmWriter, "write", write)
    outcome, _ = recorded(tmp_path / "push")
    assert (outcome.why, outcome.fault) == ("nothing more can be written (No space left on device)", True)
    assert frames_in(tmp_path / "push") == outcome.state.frames


def test_it_ends_before_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture_folder, "room_left", lambda _: 150e6)
    outcome, _ = recorded(tmp_path / "push")
    assert outcome.fault
    assert outcome.why == "the disk is nearly full (150 MB are left)"


def test_the_log_stays_where_there_is_no_room_to_write_it_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("onebend.live.recording_folder.retimed", full)
    outcome, _ = recorded(tmp_path / "push")
    assert outcome.fault
    assert outcome.why.endswith("at its end nothing more could be written (No space left on device)")
    assert frames_in(tmp_path / "push") == outcome.state.frames


def test_a_bad_picture_is_not_filmed_until_it_is_good_or_told_to(tmp_path: Path) -> None:
    dark = [replace(frame, luma=np.zeros_like(frame.luma)) for frame in frames()]
    source = PlayedCamera(dark)
    states: list[CaptureState] = []
    outcome = record(folder(tmp_path), source, force(), SETTINGS, states.append, clock=PlayedClock())
    assert outcome.film is None
    assert "to its end before the picture was good: the picture is dark and shows no tag" in outcome.why
    assert {state.stage for state in states} == {"exposure"}
    assert "the picture is dark" in states[-1].advice[0]
    assert not (tmp_path / "video.mp4").exists()
    source = PlayedCamera(dark)
    begin = threading.Event()
    begin.set()
    outcome = record(folder(tmp_path), source, force(), SETTINGS, begin=begin, clock=PlayedClock())
    assert outcome.film is not None
    assert outcome.state.frames > 80


def test_the_moments_of_a_good_picture_before_the_film_are_in_it(clean: Clean) -> None:
    outcome, states = clean
    first = next(state for state in states if state.frames)
    assert first.seconds >= SETTINGS.setup - 0.1
    assert column(outcome.folder / "frames.csv", "number")[0] == 0


def test_a_camera_that_does_not_open_costs_nothing(clean: Clean) -> None:
    path = clean[0].folder
    before = (path / "video.mp4").read_bytes()

    class Shut:
        name, timing = "the camera", StampTiming()

        def open(self, clock: Clock) -> None:  # noqa: ARG002
            raise RecordingError("/dev/video9: there is no such camera. Plug it in.")

        def read(self, wait: float) -> Frame | End | None:
            raise AssertionError(wait)

        def close(self) -> None:
            raise AssertionError

    with pytest.raises(RecordingError, match="Plug it in"):
        record(path, Shut(), force(), replace(SETTINGS, overwrite=True))
    assert (path / "video.mp4").read_bytes() == before


def test_what_the_watcher_raises_ends_it_with_a_film(tmp_path: Path) -> None:
    def watch(state: CaptureState) -> None:
        if state.seconds > 2.0:
            raise ValueError("the window was closed")

    with pytest.raises(ValueError, match="window"):
        record(folder(tmp_path), camera(), force(), SETTINGS, watch, clock=PlayedClock())
    assert frames_in(tmp_path) >= 29


class AtOnce:
    """A camera that is not played, and gives its pictures as fast as it is asked."""

    def __init__(self) -> None:
        self.name, self.timing = "the camera", StampTiming(host=True)
        self._items = iter([Frame(frame.luma, frame.time, frame.time, frame.index) for frame in frames()])

    def open(self, clock: Clock) -> None:
        pass

    def read(self, wait: float) -> Frame | End | None:  # noqa: ARG002
        return next(self._items, None) or End("the camera was switched off")

    def close(self) -> None:
        pass


@pytest.mark.parametrize("most_waiting", [10_000, 0])
def test_pictures_that_wait_are_all_filmed(tmp_path: Path, most_waiting: int) -> None:
    text = folder(tmp_path) / "recording.toml"
    text.write_text(text.read_text().partition("[force]")[0], encoding="utf-8")
    settings = replace(SETTINGS, most_waiting=most_waiting, begin_at_once=True)
    outcome = record(tmp_path, AtOnce(), None, settings, clock=HostClock())
    assert outcome.log is None
    if most_waiting:
        assert outcome.whole
        assert outcome.state.unfollowed == 0
    else:
        assert outcome.why == "the camera was switched off"
        assert outcome.state.unfollowed > 0
        assert outcome.state.frames == len(frames())
    times = column(tmp_path / "frames.csv", "time_s")
    assert all(b > a for a, b in pairwise(times.tolist()))


def test_tags_do_not_wait_for_the_encoder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = folder(tmp_path) / "recording.toml"
    text.write_text(text.read_text().partition("[force]")[0], encoding="utf-8")
    real, seen, waited = FilmWriter.write, threading.Event(), list[bool]()

    def write(self: FilmWriter, picture: Picture, time: float, colour: object = None) -> bool:
        waited.append(seen.wait(20.0))  # an encoder that goes on when tags were seen, and not before
        return real(self, picture, time, colour)

    monkeypatch.setattr(FilmWriter, "write", write)
    settings = replace(SETTINGS, begin_at_once=True)
    outcome = record(tmp_path, AtOnce(), None, settings, clock=HostClock(), tags=lambda *_: seen.set())
    assert waited[0]
    film = read_recording(tmp_path).video
    assert film is not None
    assert len(list(read_frames(film))) == outcome.state.frames == len(waited)


def test_the_room_left_is_that_of_the_disk(tmp_path: Path) -> None:
    assert capture_folder.room_left(tmp_path) > 0.0
    assert np.isnan(capture_folder.room_left(tmp_path / "nowhere"))
