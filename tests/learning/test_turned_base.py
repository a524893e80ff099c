"""A cable on a turned base: its poses are in one of two equilibria, and the points say in which."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from onebend.beam.continuation import follow
from onebend.beam.model import Beam
from onebend.beam.problem import Problem, make_problem
from onebend.beam.stiffness import Table, Uniform
from onebend.learning.frames import loads_of
from onebend.learning.optimizer import FitSettings
from onebend.learning.static_poses import RESOLUTION, SeenPoses, nearest, pose_rms, seen_poses, stay, unexplained
from onebend.learning.validation import validate
from onebend.pipeline import Run, learn
from onebend.recording.observe import observe
from onebend.records import Array, Observations
from onebend.report.sentences import worded
from tests.beam.turned_chain import Cable
from tests.recording.turned import S, turned_folder, ways

pytestmark = pytest.mark.usefixtures("no_other_places")

PLACES = np.linspace(0.0, 1.0, 41)
CABLE = Cable(0.5, lambda s: 0.015 * np.exp(0.6 * (0.5 - s)), 0.04, 0.02)
BEAM = Beam(0.5, Table(tuple(PLACES), tuple(CABLE.k(PLACES))), mass_per_length=Uniform(0.04))
DEGREES = [0.0, 30.0, 60.0, 85.0, 95.0, 100.0, 120.0, 165.0]
SD = 5e-4
FEW = FitSettings(functions=10)
MIXED = [5, 2, 7, 0, 3, 4, 6, 1]  # in which the poses stand in the tables
BACK = [3, 4, 5]  # of DEGREES: seen on the way back, too
ANGLES = [DEGREES[i] for i in MIXED + BACK]
NAMES = [f"up-{DEGREES[i]:.0f}" for i in MIXED] + [f"back-{DEGREES[i]:.0f}" for i in BACK]


@cache
def points() -> Array:
    """(11, 10, 2) m in the room, as they are."""
    up, back = ways(CABLE, DEGREES)
    return np.asarray(np.concatenate([up[MIXED], back[BACK]]))


def noisy() -> Array:
    return np.asarray(points() + SD * np.random.default_rng(7).normal(size=points().shape))


def folder(place: Path, shown: Array | None = None, **more: Sequence[object]) -> Path:
    return turned_folder(place, CABLE, NAMES, ANGLES, noisy() if shown is None else shown, sd=SD, more=more)


def true_poses(o: Observations) -> tuple[Problem, SeenPoses]:
    """The true beam under the loads of each pose, and what is seen of it."""
    seen = seen_poses(o, o.loaded)
    assert seen is not None
    return make_problem(BEAM, loads_of(o, o.loaded), RESOLUTION), seen


def off_by(run: Run) -> Array:
    """k(s) over the true one, less one."""
    return np.asarray(run.beam.stiffness(PLACES) / CABLE.k(PLACES) - 1.0)


def test_the_points_choose_the_equilibrium(tmp_path: Path) -> None:
    o = observe(folder(tmp_path / "cable"))
    problem, seen = true_poses(o)
    chosen, grown = nearest(problem, seen), follow(problem)
    assert chosen.converged.all()
    assert np.all(pose_rms(o.xy - chosen.xy(S)) < 2.0 * SD)
    assert np.max(pose_rms(o.xy - grown.xy(S))) > 0.1  # some of them are not in the one that grows from rest
    one_point = replace(seen, xy=np.where(np.arange(10)[:, None] == 4, seen.xy, np.nan))
    np.testing.assert_allclose(nearest(problem, one_point).q, chosen.q)  # one is enough


def test_a_pose_stays_in_its_equilibrium_until_that_ends(tmp_path: Path) -> None:
    problem, seen = true_poses(observe(folder(tmp_path / "cable")))
    begin = nearest(problem, seen).q
    stiffer = stay(replace(problem, k=1.02 * problem.k), begin)
    assert stiffer.converged.all()
    assert np.max(np.abs(stiffer.q - begin)) < 0.5
    much = stay(replace(problem, k=3.0 * problem.k), begin)  # of which there is one at every angle
    assert much.converged.all()
    np.testing.assert_allclose(much.q, follow(much.problem).q, atol=1e-8)


def test_only_few_poses_can_be_the_odd_ones() -> None:
    assert unexplained(np.array([1.0, 1.0, 90.0, 2.0]), 500.0).tolist() == [False, False, True, False]
    assert not unexplained(np.array([90.0, 80.0, 90.0, 2.0]), 500.0).any()
    assert not unexplained(np.array([1.0, 1.0, 10.0, 2.0]), 500.0).any()


@pytest.mark.slow
def test_k_is_learned_from_poses_in_any_order(tmp_path: Path) -> None:
    run = learn(folder(tmp_path / "cable"), fitting=FEW)
    assert run.posterior is not None
    inner = PLACES[4:-4]
    band = run.posterior.band(inner)
    assert np.all((band.low < CABLE.k(inner)) & (CABLE.k(inner) < band.high))
    assert np.median(band.high / band.low) < 1.15
    assert run.posterior.grade != "not to be trusted"
    assert np.all(run.trainings[0].rms < 3.0 * SD)
    assert not [remark for one in run.trainings for remark in one.remarks]
    turned = list(reversed(range(11)))
    other = turned_folder(
        tmp_path / "other", CABLE, [NAMES[i] for i in turned], [ANGLES[i] for i in turned], noisy()[turned], sd=SD
    )
    np.testing.assert_allclose(off_by(learn(other, fitting=FEW)), off_by(run), atol=2e-3)


def test_a_pose_that_nothing_explains_is_left_out_and_named(tmp_path: Path) -> None:
    shown = noisy()
    shown[2, :, 0] *= -1.0  # up-165, mirrored
    run = learn(folder(tmp_path / "cable", shown), fitting=FEW)
    assert run.posterior is not None
    assert [int(np.sum(left_out)) for left_out in run.posterior.left_out] == [1]
    assert any("pose up-165 was left out" in remark.text for remark in run.remarks)
    [warning] = worded(run.trainings[0].remarks)
    assert warning.about == "pose"
    assert "pose up-165 by " in warning.text
    assert np.all(np.abs(off_by(run)[4:-4]) < 0.1)


def test_validation_takes_the_equilibrium_that_is_seen(tmp_path: Path) -> None:
    compared = validate(BEAM, observe(folder(tmp_path / "cable")))
    assert np.all(compared.rms < 2.5 * SD)
    assert not compared.remarks
