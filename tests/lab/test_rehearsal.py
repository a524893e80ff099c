"""A rehearsal: its prediction against a brute-force estimate, its advice, its runs, its errors."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.simulated_runs import SimulatedRun, benches, obtained_of, simulate
from onebend.cli import app
from onebend.errors import MechanicsError, RecordingError
from onebend.lab.designs import DESIGNS
from onebend.lab.forecast import (
    BASIS,
    SPLINE,
    Setup,
    Tolerances,
    advise,
    even_push,
    information_of,
    instruments,
    known_beam,
    predict,
    ranges,
    setup_of,
)
from onebend.lab.random_bench import FilmRequest
from onebend.lab.rehearsal import COLUMNS, rehearsal_figure, rehearse, summary_of, write_table
from onebend.learning.design import STEPS, tag_derivatives
from onebend.learning.normal import Draws, InformationForm, stiffness_mixture
from onebend.records import PLACE_SD, Array
from onebend.report.pictures import draw
from onebend.results.model import save_model
from onebend.text_files import to_json

pytestmark = pytest.mark.usefixtures("no_other_places")

WRIST, CUBIC, UNIFORM = (
    setup_of(known_beam(name), [FilmRequest(sensor="wrist", seconds=4.0)], known_to=Tolerances(clock_sd=0.01))
    for name in ("linear", "cubic", "uniform")
)


def test_scatter_is_that_of_the_linear_estimate_under_the_equivalent_prior() -> None:
    """`(I + P)^-1 (I c + n)` over many draws of n ~ N(0, I); a normal prior's mean only shifts all of them."""
    setup = replace(WRIST, sensor=replace(WRIST.sensor, gain_sd=0.0))
    used, found = instruments(setup), predict(setup)
    information = information_of(setup, used)
    values, vectors = np.linalg.eigh(information)
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    noise = np.random.default_rng(0).standard_normal((4000, len(information))) @ root
    drawn = np.linalg.solve(information + found.prior, noise.T).T @ BASIS.T
    assert np.std(drawn, axis=0) == pytest.approx(found.scatter, rel=0.06)


@pytest.mark.slow
def test_band_and_bias_are_those_of_the_fits_own_posterior() -> None:
    """One prior: what the fit's sampler makes of the same information, with other draws."""
    setup = replace(CUBIC, sensor=replace(CUBIC.sensor, gain_sd=0.0))
    used, found = instruments(setup), predict(setup)
    information = information_of(setup, used)
    truth = np.linalg.lstsq(BASIS, np.log(found.k), rcond=None)[0]
    data, level = InformationForm(information, information @ truth), float(np.mean(np.log(found.k)))
    posterior = stiffness_mixture(SPLINE, [data], level, Draws(chains=20, burn=400, kept=400))
    sd = np.sqrt(np.einsum("si,ij,sj->s", BASIS, posterior.covariance, BASIS))
    assert np.sqrt(np.mean((found.own_sd / sd - 1.0) ** 2)) < 0.06
    assert np.max(np.abs(found.bias - BASIS @ (posterior.mean - truth)) / sd) < 0.15


@pytest.mark.slow
@pytest.mark.parametrize(
    "setup", [pytest.param(CUBIC, marks=pytest.mark.slow, id="cubic"), pytest.param(UNIFORM, id="uniform")]
)
def test_predicted_band_is_that_of_fits(setup: Setup) -> None:
    """Steps and bumps of k widen the band, an even k narrows it: as in fits of simulated recordings."""
    fits = simulate(setup, range(2))
    assert not any(fit.failure for fit in fits)
    sd = np.mean([fit.sd for fit in fits], axis=0)
    assert np.median(predict(setup).sd / sd) == pytest.approx(1.0, abs=0.08)


def test_more_information_never_widens_the_band() -> None:
    used = instruments(WRIST)
    whole = information_of(WRIST, used)
    sds = ("gain_sd", "direction_sd", "place_sd", "placement_sd", "origin_sd", "turn_sd", "clamp_sd", "clock_sd")
    for better in (replace(used, **{name: 1e-3 * getattr(used, name)}) for name in sds):
        gained = information_of(WRIST, better) - whole
        assert np.min(np.linalg.eigvalsh(gained)) > -1e-6 * np.max(np.abs(whole))


def test_with_one_clock_no_error_of_it_is_left() -> None:
    one = replace(WRIST, clock_sd=0.0)
    used = instruments(one)
    assert used.clock_sd == 0.0
    assert predict(one).quality.mean_width < predict(WRIST).quality.mean_width
    with pytest.raises(RecordingError, match="clock's sd"):
        setup_of(known_beam("linear"), [FilmRequest()], known_to=Tolerances(clock_sd=-0.01))


def test_two_equal_pushes_with_all_else_known_tell_twice_as_much() -> None:
    twice = replace(WRIST, pushes=WRIST.pushes * 2)
    used = instruments(WRIST)
    sure = replace(used, placement_sd=1e-12, turn_sd=1e-9, origin_sd=1e-12)
    single = information_of(WRIST, sure)
    double = information_of(twice, sure)
    assert double == pytest.approx(2.0 * single, rel=1e-4, abs=1e-6 * np.max(single))


def test_a_pushs_own_errors_move_the_tags_as_equilibria_say() -> None:
    """Against differences of exact equilibria: a place farther in, axes turned, a force added."""
    setup = setup_of(
        known_beam("cubic"), [FilmRequest(sensor="wrist", seconds=4.0, at_s=0.8)], known_to=Tolerances(clock_sd=0.01)
    )
    (push,), used = setup.pushes, instruments(setup)
    blocks = tag_derivatives(setup.beam, used, even_push(push), SPLINE.basis).blocks
    told = np.concatenate([blocks[name] for name in ("place", "direction", "push")], axis=-1)
    tags, h = np.asarray(setup.tags), 1e-5
    size = push.peak * np.append((np.arange(STEPS) + 0.5) / STEPS, 0.0)

    def poses(at_s: float, direction: float, more: tuple[float, float] = (0.0, 0.0)) -> Array:
        force = size[:, None] * np.array([np.cos(direction), np.sin(direction)]) + np.array(more)
        found = setup.beam.equilibrium(force, at_s=at_s)
        return np.concatenate([found.xy(tags), found.angle(tags)[..., None]], axis=-1)

    way, turn = h / setup.beam.length, push.direction
    pairs = [
        (poses(push.at_s + way, turn), poses(push.at_s - way, turn)),
        (poses(push.at_s, turn + h), poses(push.at_s, turn - h)),
        (poses(push.at_s, turn, (h, 0.0)), poses(push.at_s, turn, (-h, 0.0))),
        (poses(push.at_s, turn, (0.0, h)), poses(push.at_s, turn, (0.0, -h))),
    ]
    for i, (up, down) in enumerate(pairs):
        expected = (up - down) / (2.0 * h)
        error = np.abs(told[..., i] - expected)[:-1]  # at rest a force that is not there has no error
        assert np.max(error) < 3e-4 * np.max(np.abs(expected)), i


@pytest.mark.slow
def test_an_unknown_gain_costs_most_and_its_calibration_is_advised() -> None:
    vague = replace(WRIST, sensor=replace(WRIST.sensor, gain_sd=0.2))
    changes = advise(vague, predict(vague))
    assert {one.kind for one in changes[:2]} == {"gain", "sensor"}
    shares = [one.share for one in changes]
    assert shares == sorted(shares, reverse=True)
    again = predict(changes[0].setup).quality.mean_width  # chooses the prior's sizes anew
    assert again == pytest.approx(changes[0].quality.mean_width, rel=0.15)


@pytest.mark.slow
def test_runs_are_repeatable_and_their_bands_are_those_predicted() -> None:
    first = simulate(WRIST, [3])
    assert not first[0].failure
    assert simulate(WRIST, [3])[0].error == first[0].error
    sd = np.asarray(first[0].sd)
    assert np.mean(np.abs(first[0].error) < 4.0 * sd) > 0.95
    assert 0.75 < np.median(predict(WRIST).sd / sd) < 1.4  # tolerances are stated, the bench is better


@pytest.mark.slow
def test_a_sensor_without_errors_can_be_fitted() -> None:
    """A log more exact than rounding lets the fit's equations follow."""
    [one] = simulate(
        setup_of(
            known_beam("quadratic"), [FilmRequest(sensor="ideal", seconds=6.0)], known_to=Tolerances(clock_sd=0.01)
        ),
        [0],
    )
    assert one.failure == ""
    assert np.sqrt(np.mean(np.square(one.error[5:90]))) < 0.03


def test_every_run_draws_its_own_errors_and_pushes_share_them() -> None:
    twice = replace(WRIST, pushes=WRIST.pushes * 2)
    (one, other), (new, _) = benches(twice, 0), benches(twice, 1)
    assert one.tags == other.tags
    assert one.sensor == other.sensor
    assert one.clock != other.clock
    assert one.tags != new.tags
    assert one.sensor.gain != new.sensor.gain
    inner = replace(WRIST, pushes=(replace(WRIST.pushes[0], at_s=0.8),))
    missed = np.array([benches(inner, seed)[0].push.at_s - 0.8 for seed in range(200)]) * inner.beam.length
    assert np.std(missed) == pytest.approx(PLACE_SD, rel=0.2)
    assert {benches(inner, seed)[0].declared.push_s for seed in range(3)} == {0.8}
    assert all(benches(WRIST, seed)[0].push.at_s <= 1.0 for seed in range(20))


def test_coverage_counts_identified_places_only() -> None:
    inside = SimulatedRun(0, error=(0.1,) * 101, sd=(0.1,) * 101, identified=(True,) * 101)
    outside = SimulatedRun(1, error=(0.3,) * 101, sd=(0.1,) * 101, identified=(True,) * 50 + (False,) * 51)
    found = obtained_of((inside, outside, SimulatedRun(2, failure="no push")))
    assert found is not None
    assert found.runs == 2
    assert found.failed == 1
    assert found.covered == pytest.approx(101.0 / 151.0)
    assert found.coverage == pytest.approx(np.full(101, 0.5))
    assert obtained_of((SimulatedRun(2, failure="no push"),)) is None


def test_ranges_are_those_of_the_mask() -> None:
    known = np.zeros(101, dtype=bool)
    known[:11] = known[50:] = True
    assert ranges(known) == [(0.0, 0.1), (0.5, 1.0)]
    assert ranges(np.zeros(101, dtype=bool)) == []


@pytest.mark.parametrize(
    ("tags", "asked", "says"),
    [
        ((0.5, 1.2), FilmRequest(), "beyond the tip"),
        ((0.5, 0.505), FilmRequest(), "overlap"),
        ((), FilmRequest(at_s=0.2), "before the first tag"),
        ((), FilmRequest(push="fast"), "swing"),
        ((), FilmRequest(seconds=0.3), "frames"),
        ((), FilmRequest(force=-1.0), "above zero"),
        ((), FilmRequest(force=50.0, direction=np.pi), "snaps through"),
        ((), FilmRequest(force=1e-3), "Push harder"),
    ],
)
def test_nonsense_is_refused(tags: tuple[float, ...], asked: FilmRequest, says: str) -> None:
    with pytest.raises((RecordingError, MechanicsError), match=says):
        rehearse(setup_of(known_beam("quadratic"), [asked], tags=tags))


def test_a_learned_model_can_be_rehearsed(tmp_path: Path) -> None:
    save_model(tmp_path / "model.json", DESIGNS["uniform"].beam(), written_by="a test")
    known = known_beam(str(tmp_path))
    assert known.beam.length == DESIGNS["uniform"].length
    assert known_beam(str(tmp_path / "model.json")).beam.length == known.beam.length


def test_files_hold_what_was_found(tmp_path: Path) -> None:
    found = rehearse(WRIST, count=2)
    write_table(tmp_path, found)
    draw({"rehearsal": partial(rehearsal_figure, found)}).write(tmp_path)
    rows = (tmp_path / "rehearsal.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0] == ",".join(COLUMNS)
    assert len(rows) == 102
    page = (Path(__file__).parents[2] / "docs" / "plan.md").read_text(encoding="utf-8")
    assert all(f"`{column}`" in page for column in COLUMNS)
    summary = json.loads(to_json(summary_of(found)))
    assert len(summary["advice"]) == 2
    assert {path.name for path in tmp_path.iterdir()} == {"rehearsal.csv", "rehearsal.png"}


def test_command_line() -> None:
    asked = ["rehearse", "linear", "--sensor", "wrist", "--tags", "0.4,1", "-q"]
    twice = ["--push-at", "1", "--push-at", "0.7"]
    told = CliRunner().invoke(app, asked)
    assert told.exit_code == 0
    assert "Changes, by how much" in told.stdout
    out = CliRunner().invoke(app, [*asked, *twice, "--json", "--count", "0"])
    assert [p["at_s"] for p in json.loads(out.stdout)["setup"]["pushes"]] == [1.0, 0.7]
    for wrong, says in ((["--tags", "a,b"], "write places"), ([*twice, *["--force-N", "1"] * 3], "once a push")):
        refused = CliRunner().invoke(app, [*asked, *wrong])
        assert refused.exit_code == 2
        assert says in refused.output
