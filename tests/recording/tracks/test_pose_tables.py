"""Bench poses: any way of writing one bench down gives the same observations, and the fit finds the beam."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from onebend.beam.continuation import follow
from onebend.beam.loads import Loads, push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import make_problem
from onebend.beam.statics import Equilibrium
from onebend.beam.stiffness import Scaled, Table
from onebend.errors import LearningError, ObservationError, RecordingError
from onebend.learning.fit_data import fit_data
from onebend.learning.frames import loads_of
from onebend.learning.optimizer import FitSettings
from onebend.learning.parameters import Spline, make_layout
from onebend.learning.posterior import fit
from onebend.learning.prediction import predict
from onebend.learning.start import start_of, with_mass
from onebend.learning.verdict import mass_notices
from onebend.pipeline import learn
from onebend.recording.observe import observe
from onebend.records import Array, Observations
from onebend.report.sentences import words
from onebend.results.observations_file import load_observations, save_observations
from tests.recording.tracked import ROD, ROD_S, pose_folder

pytestmark = pytest.mark.usefixtures("no_other_places")

G = 9.81
HUNG = np.linspace(0.0, 0.25, 6)  # N at the tip
TIP_LOADS = "pose,s,weight_N\n" + "".join(f"{i},1,{w}\n" for i, w in enumerate(HUNG))
DOWN = np.array([0.0, -1.0])
FEW = FitSettings(functions=10)


def solved(loads: Loads, beam: Beam = ROD) -> Equilibrium:
    return follow(make_problem(beam, loads))


def hanging(beam: Beam = ROD) -> Array:
    """(6, 5, 2) m: the rod, clamped level, with `HUNG` at its tip."""
    return np.asarray(solved(push(HUNG[:, None] * DOWN) + weight(G * DOWN), beam).xy(ROD_S))


def noisy(points: Array, sd: float, seed: int = 0) -> Array:
    return np.asarray(points + sd * np.random.default_rng(seed).normal(size=points.shape))


def seen(folder: Path, **options: object) -> Observations:
    given: dict[str, object] = {"loads": TIP_LOADS, "shown": hanging(), "beam": "mass_kg = 0.03\n"}
    return observe(pose_folder(folder, **{**given, **options}))  # type: ignore[arg-type]


def test_a_level_bench_is_read_as_written(tmp_path: Path) -> None:
    o = seen(tmp_path)
    np.testing.assert_allclose(o.xy, hanging(), atol=1e-8)
    np.testing.assert_allclose(o.force, HUNG[:, None] * DOWN, atol=1e-15)
    np.testing.assert_allclose(o.gravity, np.tile(G * DOWN, (6, 1)), atol=1e-15)
    assert o.static
    assert not o.sd_known
    assert o.loaded.all()
    assert (o.force_sd == 0.0).all()


@pytest.mark.parametrize("degrees", [-90.0, -20.0, 37.0, 90.0])
def test_the_clamp_may_stand_at_any_angle(tmp_path: Path, degrees: float) -> None:
    """Room's axes, a clamp angle a pose, weights in kg: in the beam's frame the poses are equilibria."""
    turn = np.radians(degrees)
    back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    down = back @ DOWN
    there = solved(push(HUNG[:, None] * down) + weight(G * down)).xy(ROD_S)
    loads = "pose,s,mass_kg,clamp_deg\n" + "".join(f"{i},1,{w / G:.12f},{degrees}\n" for i, w in enumerate(HUNG))
    o = seen(tmp_path, loads=loads, shown=there @ back)
    np.testing.assert_allclose(o.xy, there, atol=1e-8)
    np.testing.assert_allclose(solved(loads_of(o, o.loaded)).xy(ROD_S), o.xy, atol=1e-8)


def test_several_loads_and_a_gripped_end(tmp_path: Path) -> None:
    """Two weights, a wrench at the tip and a moment: all of it reaches the mechanics."""
    everything = (
        push(np.array([[0.0, -0.1], [0.05, 0.12]]), 1.0)
        + push(np.array([[0.0, -0.2], [0.0, 0.0]]), 0.4)
        + twist(np.array([0.0, 0.03]), 1.0)
        + twist(np.array([-0.01, 0.0]), 0.6)
        + weight(G * DOWN)
    )
    table = "pose,s,weight_N,fx_N,fy_N,moment_N_m\n0,1,0.1,,,\n0,0.4,0.2,,,\n0,0.6,,,,-0.01\n1,1,,0.05,0.12,0.03\n"
    there = solved(everything).xy(ROD_S)
    o = seen(tmp_path, loads=table, shown=there)
    assert o.known_loads is not None
    np.testing.assert_allclose(solved(loads_of(o, o.loaded)).xy(ROD_S), there, atol=1e-7)  # the resolution
    assert o.push_s.tolist() == [0.4, 1.0]  # the largest force of each pose


def test_a_ruler_gives_one_coordinate(tmp_path: Path) -> None:
    o = seen(tmp_path, shown=hanging()[..., 1:], columns=("y_m",))
    assert np.isnan(o.xy[..., 0]).all()
    np.testing.assert_allclose(o.xy[..., 1], hanging()[..., 1], atol=1e-8)
    upright = TIP_LOADS.replace("weight_N", "weight_N,clamp_deg").replace("\n", ",90\n").replace("deg,90", "deg")
    up = seen(tmp_path, loads=upright, shown=hanging()[..., 1:], columns=("y_m",))
    np.testing.assert_allclose(up.xy[..., 0], hanging()[..., 1], atol=1e-8)  # the room's y is the clamp's x
    assert np.isnan(up.xy[..., 1]).all()


@pytest.mark.slow
@pytest.mark.parametrize("ruler", [False, True], ids=["both", "ruler"])
def test_k_is_learned_with_its_band(tmp_path: Path, ruler: bool) -> None:
    """Clamp 0.7 deg off, points read to 0.5 mm by somebody who does not say so, one in six missing."""
    tilted = replace(ROD, clamp_angle=np.radians(0.7))
    shown = noisy(hanging(tilted), 5e-4)
    shown[np.random.default_rng(1).random(shown.shape[:2]) < 1 / 6] = np.nan
    options = {"shown": shown[..., 1:], "columns": ("y_m",)} if ruler else {"shown": shown}
    o = seen(tmp_path, poses='axes = "room"\nclamp_sd_deg = 1\n', **options)
    posterior = fit([o], start_of([o], None), settings=FEW)
    s = np.linspace(0.1, 0.7, 13)
    band, true = posterior.band(s), ROD.stiffness(s)
    assert np.all((band.low < true) & (true < band.high))
    assert np.all(np.abs(band.k / true - 1) < 0.15)
    marker = posterior.optimum.hyperparameters.noise[0].marker  # over the guess, a thousandth of the length
    assert 0.6 < marker < 1.6
    clamp = next(n for n in posterior.nuisances() if "clamp" in n.name)
    assert abs(clamp.value - np.radians(0.7)) < 3 * clamp.sd < np.radians(2.0)


@pytest.mark.slow
def test_an_exact_table_gives_k_closely(tmp_path: Path) -> None:
    o = seen(tmp_path, poses='axes = "room"\nsd_m = 1e-5\n', shown=noisy(hanging(), 1e-5))
    assert o.sd_known
    posterior = fit([o], start_of([o], None), settings=FEW)
    s = np.linspace(0.05, 0.85, 9)
    np.testing.assert_allclose(posterior.beam.stiffness(s), ROD.stiffness(s), rtol=0.06)
    assert posterior.optimum.hyperparameters.noise[0].marker >= 1.0


@pytest.mark.slow
def test_mass_is_learned_beside_k_where_weights_fix_the_scale(tmp_path: Path) -> None:
    loads = "pose,s,weight_N\n" + "".join(f"{i},1,{w}\n" for i, w in enumerate(HUNG))
    beam = 'rest = "straight"\n'  # a rest shape that is unknown bends the rod much as its weight does
    o = seen(tmp_path, loads=loads, shown=noisy(hanging(), 5e-5), beam=beam, poses='axes = "room"\nsd_m = 5e-5\n')
    assert np.isnan(o.stated.mass)
    ready = with_mass([o])
    mass = fit(ready, start_of(ready, None), settings=FEW).mass
    assert mass is not None
    assert mass.identified
    assert abs(mass.value - 0.03) < 3 * mass.sd < 0.03
    assert "estimated with k(s)" in words(*mass_notices(mass))


def test_weight_alone_tells_only_the_ratio(tmp_path: Path) -> None:
    o = seen(tmp_path, loads="pose,s,weight_N\n0,,\n", shown=hanging()[:1], beam="")
    with pytest.raises(LearningError, match="only the ratio k/mu"):
        with_mass([o])
    heavier = replace(ROD, stiffness=Scaled(3.0, ROD.stiffness), mass_per_length=Scaled(3.0, ROD.mass_per_length))
    np.testing.assert_allclose(hanging(heavier)[0], hanging()[0], atol=1e-9)  # it is the physics that cannot tell
    known = seen(tmp_path, loads="pose,s,weight_N\n0,,\n", shown=hanging()[:1])
    mass = fit([known], start_of([known], None), settings=FEW).mass
    assert mass is not None
    assert not mass.identified
    assert "only k/mu" in words(*mass_notices(mass))


def test_a_profile_of_the_mass_is_used(tmp_path: Path) -> None:
    line = Table((0.0, 0.5, 1.0), (0.1, 0.05, 0.02))
    uneven = replace(ROD, mass_per_length=line)
    tmp_path.mkdir(exist_ok=True)
    rows = "".join(f"{s},{line(s)}\n" for s in np.linspace(0, 1, 41))
    (tmp_path / "mass.csv").write_text("s,kg_per_m\n" + rows)
    o = seen(tmp_path, beam='mass_file = "mass.csv"\n', shown=hanging(uneven))
    s = np.linspace(0, 1, 2001)
    assert o.stated.mass == pytest.approx(0.5 * np.trapezoid(line(s), s), rel=1e-3)
    posterior = fit([o], start_of([o], None), settings=FEW)
    np.testing.assert_allclose(posterior.beam.mass_per_length(s), line(s), rtol=0.2)
    halved = seen(tmp_path, beam=f'mass_file = "mass.csv"\nmass_kg = {o.stated.mass / 2}\n', shown=hanging(uneven))
    assert halved.stated.mass_line is not None
    assert o.stated.mass_line is not None
    np.testing.assert_allclose(halved.stated.mass_line.value, o.stated.mass_line.value / 2)


def test_poses_come_through_the_pipeline_and_back_from_disk(tmp_path: Path) -> None:
    loads = TIP_LOADS.replace("weight_N\n", "weight_N,moment_N_m\n") + "0,0.5,,0.001\n"
    folder = pose_folder(tmp_path / "rod", loads=loads, shown=noisy(hanging(), 5e-4), beam="mass_kg = 0.03\n")
    run = learn(folder, fitting=FEW, validate_on=[])
    assert run.learned is None
    assert run.posterior is not None
    assert run.trainings[0].rms.max() < 0.005
    save_observations(tmp_path / "o.parquet", run.recordings[0])
    back = load_observations(tmp_path / "o.parquet")
    np.testing.assert_array_equal(back.xy, run.recordings[0].xy)
    assert (back.static, back.sd_known) == (True, False)
    assert back.known_loads is not None
    assert run.recordings[0].known_loads is not None
    np.testing.assert_array_equal(back.known_loads.moment, run.recordings[0].known_loads.moment)
    assert back.known_loads.force.shape == run.recordings[0].known_loads.force.shape


@pytest.mark.slow
def test_the_example_is_learned() -> None:
    """It was made with k = 0.5 and 0.35 N m there, read to half a millimetre, the clamp 0.4 deg off."""
    run = learn(Path(__file__).parents[3] / "examples" / "hung-weights", fitting=FEW)
    assert run.posterior is not None
    band = run.posterior.band(np.array([0.35, 0.6]))
    assert np.all((band.low < [0.5, 0.35]) & (band.high > [0.5, 0.35]))
    np.testing.assert_allclose(band.k, [0.5, 0.35], rtol=0.1)


def test_moving_a_push_from_frame_to_frame_keeps_the_derivatives(tmp_path: Path) -> None:
    """Loads at other places in every pose: the fit's derivatives are those of differences."""
    table = "pose,s,weight_N\n0,1,0.1\n1,0.5,0.2\n2,0.8,0.15\n"
    o = seen(tmp_path, loads=table, shown=hanging()[:3])
    spline = Spline(6)
    one = fit_data(o, 0, np.ones(3, dtype=bool), spline)
    at = make_layout(spline, [o], [0])
    x = 0.01 * np.random.default_rng(0).normal(size=at.size)
    x[:6] += np.log(0.2)
    now = predict(one, at, x, None)
    exact = now.slopes.written
    for i in range(at.size):
        step = 1e-5 * np.eye(at.size)[i]
        ahead, behind = (predict(one, at, x + way, now.solved.q).pose for way in (step, -step))
        np.testing.assert_allclose(exact[..., i], (ahead - behind) / 2e-5, atol=2e-7)


@pytest.mark.parametrize(
    ("old", "new", "options", "words"),
    [
        ("0,1,0.0\n", "0,,0.3\n", {}, ["line 2", "a load needs its place"]),
        ("pose,s", "posture,s", {}, ["no column pose"]),
        ("5,1,", "6,1,", {}, ["the pose is not in loads.csv"]),
        ("1,0.05", "1,heavy", {}, ["weight_N is 'heavy'"]),
        ("", "", {"gravity": ""}, ["clamp's angle"]),
        ("", "", {"shown": 1000 * hanging()}, ["in metres"]),
        ("", "", {"shown": hanging() * np.nan}, ["has no rows"]),
    ],
    ids=["no place", "no pose", "unknown pose", "text", "no clamp angle", "millimetres", "no points"],
)
def test_mistakes_are_named(tmp_path: Path, old: str, new: str, options: dict[str, object], words: list[str]) -> None:
    with pytest.raises((RecordingError, ObservationError)) as told:
        seen(tmp_path, loads=TIP_LOADS.replace(old, new, 1), **options)
    for word in words:
        assert word in str(told.value)


def test_one_coordinate_needs_a_level_or_upright_clamp(tmp_path: Path) -> None:
    gravity = "[gravity]\ndirection_deg = -90\nbase_angle_deg = 30\n"
    with pytest.raises(ObservationError, match="neither level nor upright"):
        seen(tmp_path, shown=hanging()[..., 1:], columns=("y_m",), gravity=gravity)


def test_numbers_under_a_name_that_nobody_reads_are_refused(tmp_path: Path) -> None:
    """Ignored, they would be a load that is missing, or one in another unit."""
    with pytest.raises(RecordingError, match=r"weight_g, which is not known: did you mean weight_N\?"):
        seen(tmp_path, loads=TIP_LOADS.replace("weight_N", "weight_g"))
    remarked = TIP_LOADS.replace("weight_N\n", "weight_N,by\n").replace("0.05\n", "0.05,Ann\n")
    assert len(seen(tmp_path, loads=remarked).time) == 6
    folder = pose_folder(tmp_path / "rod", loads=TIP_LOADS, shown=hanging())
    table = (folder / "poses.csv").read_text()
    (folder / "poses.csv").write_text(table.replace("x_m", "x_mm"))
    with pytest.raises(RecordingError, match=r"did you mean x_m\?"):
        observe(folder)
    (folder / "poses.csv").write_text(table.replace(",", ";"))
    with pytest.raises(RecordingError, match="semicolons"):
        observe(folder)


def test_a_length_in_millimetres_is_refused(tmp_path: Path) -> None:
    folder = pose_folder(tmp_path / "rod", loads=TIP_LOADS, shown=hanging())
    text = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(text.replace(f"length_m = {ROD.length}", "length_m = 500.0"))
    with pytest.raises(RecordingError, match=r"at most 50, not 500\.0"):
        observe(folder)


@pytest.mark.slow
def test_a_wrong_pose_under_a_load_elsewhere_is_left_out(tmp_path: Path) -> None:
    """Without it all loads hang at the tip, and the beam is solved on another grid."""
    tip, middle = push(HUNG[1:, None] * DOWN), push(np.array([[0.0, -0.6]]), 0.6)
    shown = np.concatenate([solved(tip).xy(ROD_S), -solved(middle).xy(ROD_S)])
    loads = "pose,s,fy_N\n" + "".join(f"{i},1,{-w}\n" for i, w in enumerate(HUNG[1:])) + "5,0.6,-0.6\n"
    o = seen(tmp_path, loads=loads, shown=noisy(shown, 2e-4), gravity="", poses="", beam='rest = "straight"\n')
    posterior = fit([o], start_of([o], None), settings=FEW)
    assert posterior.left_out[0].tolist() == [False] * 5 + [True]
    s = np.linspace(0.1, 0.7, 7)
    np.testing.assert_allclose(posterior.beam.stiffness(s), ROD.stiffness(s), rtol=0.1)
