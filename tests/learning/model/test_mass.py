"""Stated spreads of the mass: the weight follows k(s) exactly, and one number is learned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from onebend.beam.continuation import follow
from onebend.beam.loads import push, weight
from onebend.beam.model import Beam
from onebend.beam.problem import make_problem
from onebend.beam.stiffness import Scaled, Table
from onebend.errors import LearningError, RecordingError
from onebend.learning.fit_data import POWERS, fit_data
from onebend.learning.parameters import Spline, make_layout, shared_mass
from onebend.learning.posterior import fit
from onebend.learning.prediction import predict
from onebend.learning.start import start_of, with_mass
from onebend.learning.verdict import mass_notices
from onebend.recording.observe import observe
from onebend.records import Array, MassAlong, Observations
from onebend.report.sentences import words
from tests.learning.bench import IDEAL
from tests.made_up import with_stated
from tests.recording.tracked import ROD, ROD_S, pose_folder

pytestmark = pytest.mark.usefixtures("no_other_places")

G = 9.81
HUNG = np.linspace(0.0, 0.25, 6)  # N
DOWN = np.array([0.0, -1.0])
S = np.linspace(0.0, 1.0, 2001)


def rod(power: float, mass: float = 0.03) -> Beam:
    """`ROD` with that mass, which goes as a power of its k."""
    share = ROD.stiffness(S) ** power
    line = mass / ROD.length * share / np.trapezoid(share, S)
    return replace(ROD, mass_per_length=Table(tuple(S.tolist()), tuple(line.tolist())))


def bench(folder: Path, beam: Beam, along: str, *, entry: str = "", sd: float = 2e-5) -> Observations:
    there = follow(make_problem(beam, push(HUNG[:, None] * DOWN) + weight(G * DOWN))).xy(ROD_S)
    shown: Array = there + sd * np.random.default_rng(0).normal(size=there.shape)
    loads = "pose,s,weight_N\n" + "".join(f"{i},1,{w}\n" for i, w in enumerate(HUNG))
    stated = f'{entry}mass_along = "{along}"\nrest = "straight"\n'
    poses = f'axes = "room"\nsd_m = {sd}\n'
    return observe(pose_folder(folder, loads=loads, shown=shown, beam=stated, poses=poses))


@pytest.mark.parametrize("along", ["unknown", *POWERS])
def test_the_weight_follows_k_with_exact_derivatives(tmp_path: Path, along: MassAlong) -> None:
    o = bench(tmp_path, ROD, along, entry="mass_kg = 0.03\n")
    at = make_layout(Spline(8), [o], [0])
    seen = fit_data(o, 0, np.ones(len(o.time), dtype=bool), at.spline)
    rng = np.random.default_rng(1)
    x = 0.01 * rng.normal(size=at.size)
    x[: at.spline.count] += np.log(0.3) + 0.2 * rng.normal(size=at.spline.count)
    now = predict(seen, at, x, None)
    analytic = now.slopes.written
    for i in [0, 3, 7, *range(at.index["mass", -1].where.start, at.index["mass", -1].where.stop)]:
        step = 1e-6 * np.eye(at.size)[i]
        a, b = (predict(seen, at, x + sign * step, now.solved.q).pose for sign in (1.0, -1.0))
        numeric = (a - b) / 2e-6
        np.testing.assert_allclose(analytic[..., i], numeric, atol=1e-6 * max(float(np.abs(numeric).max()), 1e-3))


@pytest.mark.parametrize(
    ("along", "power"),
    [pytest.param(*one, marks=() if one[0] == "even" else pytest.mark.slow) for one in POWERS.items()],
)
def test_one_number_is_learned_where_the_spread_is_stated(tmp_path: Path, along: str, power: float) -> None:
    ready = with_mass([bench(tmp_path, rod(power), along)])
    posterior = fit(ready, start_of(ready, None), settings=replace(IDEAL, functions=10))
    mass = posterior.mass
    assert mass is not None
    assert mass.identified
    assert abs(mass.value - 0.03) < 3 * mass.sd < 0.0075
    s = np.array([0.1, 0.5, 0.8])
    np.testing.assert_allclose(posterior.beam.mass_per_length(s), rod(power).mass_per_length(s), rtol=0.1)
    text = words(*mass_notices(mass))
    assert f'mass_along = "{along}"' in text
    assert "estimated with k(s)" in text


def test_a_stated_table_is_only_scaled(tmp_path: Path) -> None:
    (tmp_path / "mass.csv").write_text("s,kg_per_m\n0,0.1\n0.5,0.05\n1,0.02\n")
    line = Table((0.0, 0.5, 1.0), (0.1, 0.05, 0.02))
    heavier = replace(ROD, mass_per_length=Scaled(1.5, line))
    o = bench(tmp_path, heavier, "table", entry='mass_file = "mass.csv"\n')
    posterior = fit([o], start_of([o], None), settings=replace(IDEAL, functions=10))
    shape = posterior.beam.mass_per_length(S) / line(S)
    np.testing.assert_allclose(shape, shape[0], rtol=1e-9)
    assert 1.005 < shape[0] < 1.5  # between what was weighed and what the data say


def test_contradicting_words_on_the_mass_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="needs the table"):
        bench(tmp_path, ROD, "table")
    (tmp_path / "mass.csv").write_text("s,kg_per_m\n0,0.1\n1,0.02\n")
    with pytest.raises(RecordingError, match="both say how the mass is spread"):
        bench(tmp_path, ROD, "even", entry='mass_file = "mass.csv"\n')
    with pytest.raises(RecordingError, match='did you mean "width"'):
        bench(tmp_path, ROD, "widht")
    even = bench(tmp_path, ROD, "even", entry="mass_kg = 0.03\n")
    both = shared_mass([even, with_stated(even, mass_along="unknown")])
    assert [o.stated.mass_along for o in both] == ["even", "even"]
    with pytest.raises(LearningError, match="even and width"):
        shared_mass([even, with_stated(even, mass_along="width")])
