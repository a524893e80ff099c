"""A force log whose error comes with the load: what is expected of it, and what the fit makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz

from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers
from onebend.lab.bench import ForceSensor, PushProfile
from onebend.lab.virtual import VirtualBench, VirtualClock, VirtualRecording, observe_virtual, virtual_recording
from onebend.learning.force_error import force_error
from onebend.learning.instruments import setup_of
from onebend.learning.posterior import Posterior, fit
from onebend.records import Array, Observations
from tests.lab.from_truth import observe_from_truth
from tests.learning.bench import IDEAL
from tests.made_up import with_source, with_stated

pytestmark = pytest.mark.usefixtures("no_other_places")

PEAK = 0.4
STIFFNESS = Powers((0.02, 0.004))
SENSOR, CLOCK = ForceSensor(white_sd=0.003 * PEAK), VirtualClock(uncertainty=0.0)
BENCH = VirtualBench(Beam(0.15, STIFFNESS), PushProfile(PEAK, hold=0.6), sensor=SENSOR, clock=CLOCK)
STEPS = np.array([[0.12, -0.10], [-0.06, 0.14]]) * PEAK  # while the load grows, while it falls
S = np.linspace(0.05, 0.9, 35)


def stepped(steps: Array, *, after: float = 1.0, bench: VirtualBench = BENCH, seed: int = 0) -> VirtualRecording:
    """A recording whose log is off by `steps` (2, 2) N; by `after` of the second when the load has gone."""
    made = virtual_recording(bench, seed=seed)
    begin, end = bench.push.contact
    time = made.log.time - bench.clock.offset
    middle = 0.5 * (begin + bench.push.rise + end - bench.push.fall)
    levels = np.vstack([np.zeros(2), steps, after * steps[1]])
    error = levels[np.searchsorted([begin + 0.2, middle, end - 0.2], time)]
    return replace(made, log=replace(made.log, force=made.log.force + error))


def seen(made: VirtualRecording) -> Observations:
    return observe_from_truth(made, clock_sd=0.01, cutoff=2.5)


def error_of(found: Posterior, number: int = 0) -> tuple[Array, Array]:
    """The fitted error at the frames (F, 2) and its sd."""
    where = found.layout.index["force", number].where
    weights = np.kron(found.recordings[number].error.weights, np.eye(2))
    sd = np.sqrt(np.diag(weights @ found.covariance.among(where) @ weights.T))
    return (weights @ found.mean[where]).reshape(-1, 2), sd.reshape(-1, 2)


@pytest.fixture(scope="module")
def found() -> Posterior:
    return fit([seen(stepped(STEPS))], 0.02, settings=IDEAL)


def test_steps_of_the_load_do_not_move_k(found: Posterior) -> None:
    error = np.log(found.band(S).k / np.asarray(STIFFNESS(S)))
    assert np.sqrt(np.mean(error**2)) < 0.03  # steps of 15 % of the peak
    assert np.all((found.band(S).low < STIFFNESS(S)) & (found.band(S).high > STIFFNESS(S)))


def test_the_posterior_of_the_error_holds_the_steps(found: Posterior) -> None:
    o, push = found.recordings[0].observations, BENCH.push
    time = o.time[found.recordings[0].frames] - BENCH.clock.offset
    begin, end = push.contact
    growing = (time > begin + 0.8) & (time < begin + push.rise - 0.3)
    falling = (time > end - push.fall + 0.3) & (time < end - 0.8)
    error, sd = error_of(found)
    clean = o.source.clean_force
    assert clean is not None
    zero = np.stack([np.interp(o.time[found.recordings[0].frames], clean.zero_time, c) for c in clean.zero.T], axis=1)
    for rows, step in zip((growing, falling), STEPS, strict=True):
        true = step - zero[rows]  # what is wrong with the log once its zero is taken off
        assert np.all(np.abs(error[rows] - true) < 3.0 * sd[rows])
        assert np.max(np.abs(error[rows] - true)) < 0.5 * np.linalg.norm(step)
    assert found.optimum.hyperparameters.load * found.recordings[0].error.noise.load > 0.05 * PEAK


def test_the_set_up_carries_none_of_it_into_another_push(found: Posterior) -> None:
    setup = setup_of(found)
    assert setup is not None
    force = PEAK * np.array([[0.0, 0.3], [0.0, 0.6]])
    true = BENCH.beam.equilibrium(force).xy(np.ones(1))[:, 0]
    bent = setup.bent(found.beam, found.stiffness, force).xy(np.ones(1))[:, 0]
    assert np.max(np.linalg.norm(bent - true, axis=1)) < 1.5e-3  # the error bends the tip by 7 mm and more
    assert setup.force_sd > 0.05 * PEAK


def test_a_push_to_come_is_zeroed_in_the_rest_before_it_alone(found: Posterior) -> None:
    walks = replace(found.optimum.hyperparameters, coloured=1e-3, walk=1.0, load=0.0)
    setup = setup_of(replace(found, optimum=replace(found.optimum, hyperparameters=walks)))
    assert setup is not None
    push, own = BENCH.push, found.recordings[0].error.noise
    low, high = (own.walk * np.sqrt(seconds) for seconds in (push.rise, push.before + push.rise + push.hold))
    walked = np.sqrt(setup.force_sd**2 - walks.noise[0].force ** 2)
    assert low < walked < high  # with the rest after it, too, it would be known better than at its largest force


@pytest.mark.slow
def test_a_sensor_without_such_an_error_stays_sharp(found: Posterior) -> None:
    clean = fit([seen(stepped(np.zeros((2, 2))))], 0.02, settings=IDEAL)
    assert clean.optimum.hyperparameters.load * clean.recordings[0].error.noise.load < 0.01 * PEAK
    middle = S < 0.6
    wide, sharp = (one.stiffness.log_at(S[middle])[1] for one in (found, clean))
    assert np.mean(sharp) < 0.75 * np.mean(wide)


@pytest.mark.slow
def test_two_pushes_with_steps_of_their_own() -> None:
    other = replace(BENCH, push=replace(BENCH.push, direction=1.4), name="other")
    pushes = [seen(stepped(STEPS)), seen(stepped(-STEPS[::-1], after=0.0, bench=other, seed=1))]
    both = fit(pushes, 0.02, settings=IDEAL)
    error = np.log(both.band(S).k / np.asarray(STIFFNESS(S)))
    assert np.sqrt(np.mean(error**2)) < 0.03
    assert np.all((both.band(S).low < STIFFNESS(S)) & (both.band(S).high > STIFFNESS(S)))


def test_what_is_expected_is_alike_in_a_stage_and_anew_in_the_next() -> None:
    o = seen(stepped(STEPS))
    error, push = force_error(o, o.time[o.loaded]), BENCH.push
    time = error.knots - BENCH.clock.offset
    rise, fall = (np.flatnonzero((time > low) & (time < low + 0.7)) for low in (2.3, 4.9))
    rest = np.flatnonzero(time < push.before - 0.4)
    alike = error.stages / np.sqrt(np.outer(np.diag(error.stages), np.diag(error.stages)))
    for rows in (rise, fall, rest):
        assert np.all(alike[np.ix_(rows, rows)] > 0.98)
        assert np.diag(error.stages)[rows] == pytest.approx(1.0, abs=0.03)
    assert alike[np.ix_(rise, fall)] == pytest.approx(np.exp(-2.0), abs=0.03)
    assert alike[np.ix_(rest, fall)] == pytest.approx(np.exp(-4.0), abs=0.03)


def test_a_zero_that_ran_between_rests_is_expected_back() -> None:
    o = seen(stepped(STEPS))
    clean, error = o.source.clean_force, force_error(o, o.time[o.loaded])
    assert clean is not None
    assert clean.zero[1] - clean.zero[0] == pytest.approx(STEPS[1], abs=0.002)
    assert error.mean[0] == pytest.approx(np.zeros(2))
    assert error.mean[-1] == pytest.approx(clean.zero[0] - clean.zero[1], rel=0.01)  # the last knot is in the rest
    one = with_source(o, clean_force=replace(clean, zero_time=clean.zero_time[:1], zero=clean.zero[:1]))
    assert np.all(force_error(one, o.time[o.loaded]).mean == 0.0)


def test_the_log_long_before_and_after_the_film_tells_no_error() -> None:
    o = seen(virtual_recording(BENCH, seed=0))
    clean = o.source.clean_force
    assert clean is not None
    away = np.arange(3.0, 100.0)
    time = np.concatenate([clean.time[0] - away[::-1], clean.time, clean.time[-1] + away])
    touched = np.pad(clean.force, ((len(away), len(away)), (0, 0)), constant_values=PEAK)
    longer = with_source(o, clean_force=replace(clean, time=time, force=touched))
    short, long = (force_error(each, each.time) for each in (o, longer))
    assert len(short.rest_values) > 5
    np.testing.assert_array_equal(long.rest_values, short.rest_values)
    np.testing.assert_array_equal(long.knots, short.knots)


def test_the_log_after_a_film_that_ends_while_the_beam_is_held_is_no_rest() -> None:
    o = seen(virtual_recording(BENCH, seed=0))
    held = np.flatnonzero(o.loaded)
    cut = replace(o, loaded=o.loaded | (np.arange(len(o.time)) > held[-1]))  # as if never let go
    clean = o.source.clean_force
    assert clean is not None
    after = clean.time[-1] + np.arange(0.1, 3.0, 0.01)
    pressed = np.concatenate([clean.force, np.full((len(after), 2), PEAK)])
    longer = replace(clean, time=np.concatenate([clean.time, after]), force=pressed)
    rests = force_error(with_source(cut, clean_force=longer), o.time[o.loaded]).rest_values
    assert len(rests) > 2
    assert np.max(np.abs(rests)) < 0.1 * PEAK


@pytest.mark.slow
def test_long_rests_take_no_knots_from_the_push() -> None:
    long = replace(BENCH, push=replace(BENCH.push, before=20.0, after=10.0))
    found = [
        force_error(seen(virtual_recording(bench, seed=0)), np.linspace(252.0, 255.0, 30)) for bench in (BENCH, long)
    ]
    steps = [error.knots[1] - error.knots[0] for error in found]
    assert steps[1] == pytest.approx(steps[0], rel=0.1)
    assert len(found[1].rest_values) >= len(found[0].rest_values)


def test_what_the_knots_cannot_follow_is_noise_of_the_rests() -> None:
    o, sd = seen(virtual_recording(BENCH, seed=0)), 0.05 * PEAK
    clean = o.source.clean_force
    assert clean is not None
    noise = sd * np.random.default_rng(0).standard_normal(clean.force.shape)  # far faster than the knots
    rough = replace(clean, force=clean.force + noise, cutoff=50.0)
    error = force_error(with_source(o, clean_force=rough), o.time)
    assert error.knots[1] - error.knots[0] > 0.05
    assert error.rest_sd == pytest.approx(sd, rel=0.3)  # 18 rests more than the knots need


def test_the_root_is_that_of_the_parts_added_up() -> None:
    """The parts' covariances as they are written in the module's docstring, by sums."""
    o = seen(stepped(STEPS))
    error = force_error(o, o.time[o.loaded])
    coloured, memory, walk, load = 1.3, 0.7, 2.0, 0.5
    noise, since = error.noise, error.knots - error.knots[0]
    short = error.filtered.covariance(coloured * noise.coloured, memory * noise.tau, error.white)
    expected = toeplitz(short) + 0.03 * short[0] * np.eye(len(short)) + error.noise.level**2
    expected += (walk * noise.walk) ** 2 * np.minimum.outer(since, since) + (load * error.noise.load) ** 2 * (
        1 + error.stages
    )
    root = error.root(coloured, memory, walk, load)
    assert np.array_equal(root, np.tril(root))
    assert root @ root.T == pytest.approx(expected, abs=1e-9 * np.max(expected))


def test_a_declared_size_is_what_is_expected() -> None:
    o = seen(stepped(STEPS))
    largest = float(np.max(np.linalg.norm(o.force[o.loaded], axis=1)))
    assert force_error(o, o.time[o.loaded]).noise.load == pytest.approx(0.03 * largest)
    assert force_error(with_stated(o, load_error_sd=0.07), o.time[o.loaded]).noise.load == 0.07


@pytest.mark.slow
def test_a_log_of_minutes_that_was_touched_before_and_after_the_film_is_one_of_the_push() -> None:
    made = virtual_recording(BENCH, seed=1)
    log, away = made.log, np.arange(5.0, 200.0, 0.01)
    touched = np.pad(0.01 * PEAK * np.sin(away)[:, None] + np.abs(np.sin(0.1 * away))[:, None] * PEAK, ((0, 0), (0, 1)))
    time = np.concatenate([log.time[0] - away[::-1], log.time, log.time[-1] + away])
    minutes = replace(log, time=time, force=np.concatenate([touched[::-1], log.force, touched]))
    short, long = (observe_virtual(each) for each in (made, replace(made, log=minutes)))
    np.testing.assert_allclose(long.force_sd, short.force_sd, rtol=0.1)
    cleans = [short.source.clean_force, long.source.clean_force]
    assert cleans[0] is not None
    assert cleans[1] is not None
    assert cleans[1].time[-1] - cleans[1].time[0] < np.ptp(short.time) + 7.0
    np.testing.assert_allclose(cleans[1].zero, cleans[0].zero, atol=0.01 * PEAK)


def test_a_push_that_shows_no_rest_gives_k_and_its_unknown_zero_is_no_contradiction() -> None:
    sensor = ForceSensor(white_sd=0.003 * PEAK, bias=(0.8 * PEAK, -0.6 * PEAK))
    made = virtual_recording(replace(BENCH, sensor=sensor, fps=30.0), seed=1)
    kept = np.linalg.norm(made.force, axis=1) > 0.3 * PEAK
    time = made.log.time - made.bench.clock.offset
    logged = (time >= made.markers.time[kept][0]) & (time <= made.markers.time[kept][-1])
    one = made.markers
    of_frames = {name: getattr(one, name)[kept] for name in ("time", "xy", "angle", "covariance", "base_angle")}
    log = replace(made.log, time=made.log.time[logged], force=made.log.force[logged])
    found = fit([observe_virtual(replace(made, markers=replace(one, **of_frames), log=log))], 0.02)
    assert found.doubts == ()
    assert abs(float(np.mean(np.log(found.band(S).k / STIFFNESS(S))))) < 0.1
    assert "the force log" not in {one.name for one in found.contradictions if one.sds > 0.5}
