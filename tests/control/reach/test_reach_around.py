"""Around a reached goal: what else can be reached, how sure the point is, one goal after another, the command."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from onebend.beam.continuation import follow
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.problem import make_problems
from onebend.beam.stiffness import UncertainStiffness, Uniform
from onebend.cli import app
from onebend.control.reach import predicted_error, reach
from onebend.control.reach_set import reachable
from onebend.errors import ControlError
from onebend.report.control_figures import reaching
from onebend.results.control_files import PATH_COLUMNS
from onebend.results.model import save_model

KNOTS = np.array([0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0])
ROOT = 0.05 * np.tril(np.ones((5, 5))) * np.array([1.0, -0.7, 0.5, 0.4, -0.3])
BAND = UncertainStiffness(KNOTS, np.log(0.02) + np.array([0.3, 0.0, -0.3, 0.1, 0.2]), ROOT @ ROOT.T, 0.02)
BEAM = Beam(0.15, BAND.profile)
GOAL = BEAM.equilibrium((-0.02, 0.2)).xy(1.0)


def test_reachable_places_are_equilibria_and_hold_the_nearest_point() -> None:
    within = reachable(BEAM, max_force=0.3, directions=24, sizes=4)
    assert np.isfinite(within.points[..., 0]).mean() > 0.8
    chosen = np.flatnonzero(np.isfinite(within.points[..., 0]).ravel())[::7]
    force, places = within.force.reshape(-1, 2)[chosen], within.points.reshape(-1, 2)[chosen]
    np.testing.assert_allclose(BEAM.equilibrium(force).xy(1.0), places, atol=1e-7)
    inside = within.nearest(GOAL)
    assert inside.distance < 1e-7
    np.testing.assert_allclose(inside.force, (-0.02, 0.2), atol=1e-4)


def test_a_smaller_bound_reaches_less() -> None:
    far = BEAM.equilibrium((0.0, 0.4)).xy(1.0)
    away = [reachable(BEAM, max_force=most, directions=24, sizes=4).nearest(far).distance for most in (0.1, 0.2, 0.3)]
    assert away[0] > away[1] > away[2] > 1e-4
    bent = reachable(BEAM, max_force=0.3, max_curvature=5.0, directions=24, sizes=4)
    assert not np.isfinite(bent.points).all()
    assert bent.nearest(far).distance >= away[2]


@pytest.mark.parametrize("options", [{"max_force": 0.0}, {"max_force": 1.0, "max_curvature": -1.0},
                                     {"max_force": 1.0, "directions": 2}])  # fmt: skip
def test_bounds_without_meaning_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(ControlError):
        reachable(BEAM, **options)  # type: ignore[arg-type]


def test_predicted_error_is_that_of_beams_drawn_anew() -> None:
    found = reach(BEAM, GOAL)
    error = predicted_error(BEAM, BAND, found)
    beams = [replace(BEAM, stiffness=k) for k in BAND.draw(300, seed=9)]
    places = follow(make_problems(beams, push(np.tile(found.force, (300, 1))))).xy(np.ones(1))[:, 0]
    np.testing.assert_allclose(error.mean, places.mean(axis=0), atol=4 * places.std() / np.sqrt(300))
    inside = np.mean([error.holds(xy) for xy in places])
    assert 0.90 < inside < 0.985
    first = predicted_error(BEAM, BAND, found, draws=0)
    np.testing.assert_allclose(first.ellipse().semi_axes[0], error.ellipse().semi_axes[0], rtol=0.15)
    assert error.lost == 0.0


def test_a_common_scale_moves_the_point_as_more_force_would() -> None:
    found = reach(BEAM, GOAL)
    sure = replace(BAND, covariance=np.zeros((5, 5)))
    scale = predicted_error(BEAM, sure, found, draws=0)
    step = 1e-4
    moved = (
        BEAM.equilibrium(found.force * (1 - step)).xy(1.0) - BEAM.equilibrium(found.force * (1 + step)).xy(1.0)
    ) / 2
    np.testing.assert_allclose(scale.covariance, 0.02**2 * np.outer(moved, moved) / step**2, rtol=1e-4, atol=1e-12)
    assert np.all(predicted_error(BEAM, sure, found, draws=0, same_sensor=True).covariance == 0.0)
    with pytest.raises(ControlError, match="one model"):
        predicted_error(Beam(0.15, Uniform(0.02)), BAND, found)


def test_pictures_show_force_goal_and_ellipse() -> None:
    found = reach(BEAM, GOAL)
    within = reachable(BEAM, max_force=0.3, directions=24, sizes=4)
    figure = reaching(found, predicted_error(BEAM, BAND, found, draws=0), within)
    legend = figure.axes[0].get_legend()
    assert legend is not None
    labels = {text.get_text() for text in legend.get_texts()}
    assert {"goal", "force", "at rest", "under the force", "95 % of the places"} <= labels
    assert "on its goal" in figure.axes[0].get_title(loc="left")


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("model")
    save_model(folder / "model.json", BEAM, written_by="test", uncertain=BAND)
    return folder


def test_command_writes_the_path_the_picture_and_the_summary(model: Path, tmp_path: Path) -> None:
    out = tmp_path / "reached"
    asked = ["reach", str(model), "--goal", *(f"{v:.6f}" for v in GOAL), "-o", str(out)]
    first = CliRunner().invoke(app, [*asked, "--json"])
    assert first.exit_code == 0, first.output
    said = json.loads(first.stdout)
    np.testing.assert_allclose(said["force_N"], (-0.02, 0.2), atol=1e-3)
    assert said["converged"] is True
    assert said["error_m"] < 1e-6
    assert said["predicted_error"]["ellipse_semi_axes_m"][0] > 1e-4
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert set(summary["files"]) == {"path.csv", "reach.png", "summary.json"}
    with (out / "path.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == PATH_COLUMNS
    assert float(rows[-1]["force_y_N"]) == pytest.approx(said["force_N"][1])
    assert float(rows[0]["force_y_N"]) == 0.0
    again = CliRunner().invoke(app, asked)
    assert again.exit_code == 2
    assert "--force" in again.stderr
    assert CliRunner().invoke(app, [*asked, "--force"]).exit_code == 0


def test_command_says_what_is_out_of_reach(model: Path) -> None:
    done = CliRunner().invoke(app, ["reach", str(model), "--goal", "0.2", "0.0"])
    assert done.exit_code == 2
    assert "nearest reachable point" in done.stderr
    assert "Traceback" not in done.stderr
