"""Poses whose end an unknown wrench holds: the mechanics, the fit, and what such poses cannot tell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from onebend.beam.clamped_ends import hold_near
from onebend.beam.continuation import follow
from onebend.beam.loads import Loads, push, weight
from onebend.beam.model import Beam
from onebend.beam.problem import make_problem
from onebend.beam.stiffness import Scaled, Uniform
from onebend.errors import ObservationError, RecordingError
from onebend.learning.fit_data import fit_data
from onebend.learning.parameters import Spline, make_layout
from onebend.learning.posterior import Posterior, fit
from onebend.learning.prediction import predict
from onebend.learning.start import start_of, with_mass
from onebend.learning.static_poses import HELD_RESOLUTION, stated_notices
from onebend.pipeline import learn
from onebend.recording.observe import observe
from onebend.records import Array, Observations
from onebend.results.observations_file import load_observations, save_observations
from tests.beam.held import hold
from tests.learning.bench import IDEAL
from tests.recording.tracked import ROD, ROD_S, pose_folder

pytestmark = pytest.mark.usefixtures("no_other_places")

G = 9.81
DOWN = np.array([0.0, -1.0])
ENDS = np.array([[0.38, -0.05, -0.4], [0.30, 0.1, 0.3], [0.25, -0.1, -1.5], [0.42, 0.02, 0.6]])
HELD = "pose,s,fx_N,fy_N,moment_N_m\n"
UNKNOWN = ",1,unknown,unknown,unknown\n"
FEW = replace(IDEAL, functions=8)
LEVEL = "[gravity]\ndirection_deg = -90\nbase_angle_deg = 0\n"
HEAVY = replace(ROD, mass_per_length=Scaled(40.0, ROD.mass_per_length))  # so that its weight tells of k


def held_points(beam: Beam, loads: Loads, sd: float = 0.0) -> Array:
    points = hold(beam, ENDS, loads).solved.xy(ROD_S)
    return np.asarray(points + sd * np.random.default_rng(3).normal(size=points.shape))


def held_folder(
    folder: Path, shown: Array, *, beam: str = "mass_kg = 1.2\n", gravity: str = LEVEL, more: str = ""
) -> Path:
    loads = HELD + "".join(f"{i}{UNKNOWN}" for i in range(len(ENDS))) + more
    return pose_folder(folder, loads=loads, shown=shown, beam=beam, gravity=gravity, poses="sd_m = 2e-4\n")


def learned(o: Observations) -> Posterior:
    ready = with_mass([o])
    return fit(ready, start_of(ready, None), settings=FEW)


def test_the_equilibrium_near_a_known_shape_is_the_held_one() -> None:
    there = hold(HEAVY, ENDS, weight(G * DOWN), resolution=HELD_RESOLUTION)
    problem = make_problem(HEAVY, weight(G * DOWN).spread(len(ENDS)), HELD_RESOLUTION)
    rough = there.solved.q * (1.0 + 0.2 * np.sin(9.0 * problem.grid.nodes))
    found, wrench = hold_near(problem, rough, ENDS, fall=True)
    assert found.converged.all()
    np.testing.assert_allclose(found.q, there.solved.q, atol=1e-7)
    np.testing.assert_allclose(wrench, there.wrench, atol=1e-7)
    loose = follow(make_problem(ROD, push(wrench[:1, :2]), HELD_RESOLUTION))  # the wrench alone is another problem
    assert np.abs(loose.q - found.q[:1]).max() > 0.1


def test_derivatives_with_every_parameter_are_exact(tmp_path: Path) -> None:
    shown = np.concatenate(
        [held_points(HEAVY, weight(G * DOWN)), hold(HEAVY, ENDS[:1], weight(G * DOWN)).solved.xy(ROD_S)]
    )
    o = observe(held_folder(tmp_path / "rod", shown, more="4,1,0.3,0.2,-0.05\n"))  # held four times, free once
    at = make_layout(Spline(6), [o], [0])
    seen = fit_data(o, 0, np.ones(len(o.time), dtype=bool), at.spline)
    rng = np.random.default_rng(1)
    x = 0.01 * rng.normal(size=at.size)
    x[: at.spline.count] += np.log(0.3) + 0.2 * rng.normal(size=at.spline.count)
    now = predict(seen, at, x, None)
    assert now.solved.converged.all()
    analytic = now.slopes.written
    assert at.index["end", 0].where.stop > at.index["end", 0].where.start == at.index["origin", 0].where.stop
    for i in range(at.size):
        step = 1e-6 * np.eye(at.size)[i]
        a, b = (predict(seen, at, x + sign * step, now.solved.q).pose for sign in (1.0, -1.0))
        numeric = (a - b) / 2e-6
        np.testing.assert_allclose(analytic[..., i], numeric, atol=2e-6 * max(float(np.abs(numeric).max()), 1e-2))


@pytest.mark.slow
def test_weight_sets_the_scale_of_k_between_held_ends(tmp_path: Path) -> None:
    o = observe(held_folder(tmp_path / "rod", held_points(HEAVY, weight(G * DOWN), 2e-4)))
    posterior = learned(o)
    s = np.linspace(0.1, 0.9, 9)
    band = posterior.band(s)
    assert band.identified.any()
    assert np.all((band.low < ROD.stiffness(s)) & (ROD.stiffness(s) < band.high))
    ends = [n for n in posterior.nuisances() if "held end" in n.name]
    assert len(ends) == 3 * len(ENDS)
    assert all(n.sd < 0.05 * n.prior_sd for n in ends)
    assert stated_notices([o], posterior.stiffness) == ()
    save_observations(tmp_path / "o.parquet", o)
    back = load_observations(tmp_path / "o.parquet")
    assert back.held is not None
    assert back.held.all()


@pytest.mark.slow
def test_an_end_that_nobody_measured_is_found(tmp_path: Path) -> None:
    shown = held_points(HEAVY, weight(G * DOWN), 2e-4)
    shown[2, -1] = np.nan
    posterior = learned(observe(held_folder(tmp_path / "rod", shown)))
    block = posterior.layout.index["end", 0].where
    ends = posterior.recordings[0].ends
    assert ends is not None
    away = ends.end[:, :2] + posterior.mean[block].reshape(-1, 2) - ENDS[:, :2]
    sd = np.sqrt(posterior.covariance.diagonal[block]).reshape(-1, 2)
    assert np.all(np.abs(away[2]) < 4 * sd[2])
    assert np.all(sd[2] > 3 * sd[0])
    assert np.all(sd[2] < 0.02)


def test_without_weight_only_ratios_of_k_are_known(tmp_path: Path) -> None:
    """Scaled k and wrench give the same shapes; the fit says so, and its ratios hold."""
    ten = hold(replace(ROD, stiffness=Scaled(10.0, ROD.stiffness)), ENDS).solved
    one = hold(ROD, ENDS)
    np.testing.assert_allclose(ten.q, one.solved.q, atol=1e-8)
    folder = held_folder(tmp_path / "rod", held_points(ROD, Loads(), 5e-5), beam="", gravity="")
    run = learn(folder, fitting=FEW)
    assert run.posterior is not None
    assert not run.posterior.band(np.linspace(0.0, 1.0, 21)).identified.any()
    said = [r for r in run.remarks if "the size of k(s) is not identifiable" in r.text]
    assert [r.level for r in said] == ["warning"]
    stiffness, s = run.posterior.stiffness, np.array([0.2, 0.5, 0.8])
    rows = stiffness.basis(s) - stiffness.basis(s[[1]])
    logs, sd = rows @ stiffness.mean, np.sqrt(np.einsum("si,ij,sj->s", rows, stiffness.covariance, rows))
    true = np.log(ROD.stiffness(s) / ROD.stiffness(0.5))
    assert np.all(np.abs(logs - true) <= 3 * sd)
    assert np.all(sd < 0.4)


def test_k_stated_as_one_number_is_one(tmp_path: Path) -> None:
    """Where weight bends the beam little beside the holders, evenness is what makes k known."""
    wire = replace(HEAVY, stiffness=Uniform(0.2))
    even = 'mass_kg = 1.2\nmass_along = "even"\nstiffness_along = "even"\n'
    folder = held_folder(tmp_path / "wire", held_points(wire, weight(G * DOWN), 2e-4), beam=even)
    run = learn(folder, fitting=FEW)
    assert run.posterior is not None
    band = run.posterior.band(np.linspace(0.0, 1.0, 11))
    assert np.ptp(np.log(band.k)) < 0.01
    assert band.identified.all()
    assert np.all((band.low < 0.2) & (band.high > 0.2))
    assert np.all(band.high / band.low < 1.4)
    assert any("one number" in r.text for r in run.remarks)
    assert run.trainings[0].rms.max() < 2e-3  # validated with its ends where they were seen


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ("0,1,unknown,,\n", "write unknown for all of fx_N, fy_N, moment_N_m"),
        ("0,0.5,unknown,unknown,unknown\n", "give s = 1"),
        ("0,1,unkown,unknown,unknown\n", "fx_N is 'unkown', not a number"),
        ("0,1,inf,inf,inf\n", "fx_N is infinite"),
    ],
)
def test_a_held_end_half_written_is_refused(tmp_path: Path, row: str, reason: str) -> None:
    with pytest.raises(RecordingError, match=reason):
        observe(pose_folder(tmp_path / "rod", loads=HELD + row, shown=held_points(ROD, Loads())[:1]))


def test_a_held_pose_that_shows_too_little_is_refused(tmp_path: Path) -> None:
    shown = held_points(HEAVY, weight(G * DOWN))
    shown[1, 1:4, 0] = np.nan
    with pytest.raises(ObservationError, match="pose 1 has 2 points with both coordinates"):
        observe(held_folder(tmp_path / "rod", shown))


@pytest.mark.slow
def test_an_end_read_beyond_the_beams_reach_is_put_within(tmp_path: Path) -> None:
    """As a ruler may read a wire that hangs nearly straight."""
    end = np.array([[0.15, -0.47, -1.2]])
    points = hold(HEAVY, end, weight(G * DOWN)).solved.xy(ROD_S)
    points[0, -1] *= 0.5005 / np.linalg.norm(points[0, -1])
    folder = pose_folder(tmp_path / "rod", loads=HELD + f"0{UNKNOWN}", shown=points, beam="mass_kg = 1.2\n")
    posterior = learned(observe(folder))
    assert posterior.optimum.converged
    solved = posterior.optimum.predictions[0].solved
    assert np.linalg.norm(solved.xy(np.ones(1))[0, 0]) < 0.5
