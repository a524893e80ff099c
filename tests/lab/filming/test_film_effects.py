"""Films of real benches: tags stand in the pixels where heights, tilts, camera and rows put them; the truth says so."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from onebend.beam.model import Beam
from onebend.beam.stiffness import Uniform
from onebend.cli import app
from onebend.errors import RecordingError
from onebend.lab.bench import RealBench
from onebend.lab.filming import Filming, camera_motion, droop, film, followed, moments_at
from onebend.lab.rendering import placed_in_space, rolled
from onebend.lab.virtual import true_stiffness
from onebend.recording.folder import read_recording
from onebend.recording.plane import project
from onebend.recording.tags import detect_tags
from onebend.records import Array, View
from onebend.text_files import plain
from tests.lab.filming.test_film import BENCH, FILMING

SPACE = RealBench(
    base_height=0.004,
    tag_heights=(0.002, -0.001, 0.0),
    tag_tilts=((0.05, 0.0), (0.0, -0.06), (0.04, 0.04)),
    droop=0.004,
)
SQUARE = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
LOST_TO_PIXELS = 0.08  # px RMS, of the middles of tags found in a film of 640 x 360


def real(**effects: object) -> Filming:
    changed = replace(SPACE, **effects)  # type: ignore[arg-type]
    return replace(FILMING, lost=0.0, bench=replace(BENCH, effects=changed))


def view_of(folder: Path) -> View:
    camera = json.loads((folder / "truth" / "truth.json").read_text(encoding="utf-8"))["camera"]
    matrix, dist, rotation, at = (np.array(camera[name]) for name in ("K", "dist", "R", "t"))
    return View(matrix, dist, rotation, at, calibrated=True, corner_sd=0.0)


def expected_corners(filming: Filming, folder: Path, tags: Array) -> Array:
    """(T, m, 4, 2) px of tags (T, m, 6) by a camera that stands still."""
    faces = [[placed_in_space(filming.tag_size * SQUARE, tag) for tag in moment] for moment in tags]
    in_space = [[np.pad(face, ((0, 0), (0, 3 - face.shape[1]))) for face in row] for row in faces]
    return project(view_of(folder), np.array(in_space))


def found_corners(folder: Path) -> Array:
    rec = read_recording(folder)
    assert rec.video is not None
    return detect_tags(rec.video, rec.tags, threads=1).corners


def rms(error: Array) -> float:
    """Of the tags' middles, from their corners (..., 4, 2)."""
    return float(np.sqrt(np.nanmean(error.mean(axis=-2) ** 2)))


@pytest.mark.slow
def test_tags_in_space_are_seen_where_they_stand(tmp_path: Path) -> None:
    filming = real()
    folder = film(filming, tmp_path / "space", seed=3)
    truth = np.load(folder / "truth" / "truth.npz")
    tags = np.concatenate([truth["tag_xyaz"], truth["tag_tilts"]], axis=-1)
    found = found_corners(folder)
    assert rms(found - expected_corners(filming, folder, tags)) < LOST_TO_PIXELS
    flat = expected_corners(filming, folder, np.concatenate([tags[..., :3], np.zeros_like(tags[..., 3:])], axis=-1))
    assert rms(found - flat) > 5.0 * LOST_TO_PIXELS
    assert truth["z"][0, -1] == pytest.approx(-0.004, rel=1e-3)
    assert np.all(truth["tag_xyaz"][:, 0, 3] == 0.004)


@pytest.mark.slow
def test_a_moving_camera_moves_all_tags_alike(tmp_path: Path) -> None:
    filming = real(shake=0.4, drift=3.0)
    folder = film(filming, tmp_path / "shake", seed=3)
    truth = np.load(folder / "truth" / "truth.npz")
    tags = np.concatenate([truth["tag_xyaz"], truth["tag_tilts"]], axis=-1)
    still = expected_corners(filming, folder, tags)
    assert rms(found_corners(folder) - still - truth["camera_px"][:, None, None]) < LOST_TO_PIXELS
    assert float(np.std(truth["camera_px"])) > 0.8


@pytest.mark.slow
def test_rows_are_exposed_one_after_the_other(tmp_path: Path) -> None:
    filming = real(readout=0.04, shake=0.4)
    folder = film(filming, tmp_path / "rolling", seed=3)
    truth = np.load(folder / "truth" / "truth.npz")
    time, found = truth["t_frame"], found_corners(folder)
    wave = camera_motion(filming.bench.effects, BENCH.push.duration, np.random.default_rng([3, 13]))
    for tag in range(1, 4):
        row = np.nanmean(found[:, tag, :, 1], axis=1) / 360.0
        now = time + 0.04 * row
        moments = moments_at(filming, followed(filming, 4.0), now)
        seen = expected_corners(filming, folder, moments.tags)[:, tag] + wave.shift(now)[:, None]
        at_once = expected_corners(filming, folder, moments_at(filming, None, time).tags)[:, tag]
        assert rms(found[:, tag] - seen) < LOST_TO_PIXELS
        assert rms(found[:, tag] - at_once) > 3.0 * LOST_TO_PIXELS


def test_what_moves_the_beam_is_filmed_and_told(tmp_path: Path) -> None:
    effects = RealBench(
        thickness=0.015, relaxation=0.1, slide=0.003, push_off=-0.002, patch_factor=2.0, posture_bias=0.04, readout=0.02
    )
    filming = replace(FILMING, bench=replace(BENCH, effects=effects))
    folder = film(filming, tmp_path / "moved", seed=3)
    truth = np.load(folder / "truth" / "truth.npz")
    facts = json.loads((folder / "truth" / "truth.json").read_text(encoding="utf-8"))
    motion = followed(filming, BENCH.push.duration)
    k = true_stiffness(filming.bench, motion, truth["s"])
    np.testing.assert_allclose(truth["k_bare"], BENCH.beam.stiffness(truth["s"]))
    np.testing.assert_allclose(truth["k_instant"], k.k_instant)
    np.testing.assert_allclose(truth["k"], facts["secant_modulus"] * k.k_instant)
    assert 0.9 < facts["secant_modulus"] < 1.0
    assert facts["effects"]["slide"] == 0.003
    assert truth["s_a"][0] == pytest.approx(1.0 - 0.002 / 0.15)
    assert np.ptp(truth["s_a"]) > 0.005
    tags = np.concatenate([truth["tag_xyaz"], truth["tag_tilts"]], axis=-1)
    assert rms((found_corners(folder) - expected_corners(filming, folder, tags))[:3]) < LOST_TO_PIXELS
    logged = np.loadtxt(folder / "force.csv", delimiter=",", skiprows=1)
    assert logged.shape[0] == truth["log_F"].shape[0]
    assert np.max(np.abs(logged[:, 1:3] - truth["log_F"])) == pytest.approx(0.04 * BENCH.push.peak, rel=0.3)


def test_effects_that_do_not_fit_the_film_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="swings"):
        film(replace(real(slide=1e-3), swings=True), tmp_path / "swings", seed=0)
    with pytest.raises(RecordingError, match="one value"):
        film(real(tag_heights=(0.001,)), tmp_path / "heights", seed=0)


def test_a_straight_uniform_beam_droops_as_a_cantilever() -> None:
    s = np.linspace(0.0, 1.0, 121)
    beam = Beam(0.15, Uniform(0.02), mass_per_length=Uniform(0.3))
    z, slope = droop(beam, 0.003, s, np.stack([0.15 * s, 0.0 * s, 0.0 * s], axis=-1)[None])
    shape = (s**4 - 4 * s**3 + 6 * s**2) / 3.0
    np.testing.assert_allclose(z[0], -0.003 * shape, atol=1e-6)
    np.testing.assert_allclose(slope[0], -0.003 / 0.15 * np.gradient(shape, s, edge_order=2), atol=2e-5)
    curled = np.linspace(0.0, 2.0, 121)[None]
    bent = 0.15 / 120 * np.cumsum(np.stack([np.cos(curled), np.sin(curled)], axis=-1), axis=1)
    poses = np.concatenate([bent, curled[..., None]], axis=-1)
    assert -0.003 < droop(beam, 0.003, s, poses)[0][0, -1] < 0.0  # a bent beam hangs less


def test_the_command_films_with_effects(tmp_path: Path) -> None:
    few = ["--camera", "webcam", "--fps", "2", "--seconds", "2", "--quiet", "--seed", "3"]

    def effects(*options: str) -> dict[str, object]:
        done = CliRunner().invoke(app, ["film", "linear", *few, *options, "-o", str(tmp_path / str(len(options)))])
        assert done.exit_code == 0, done.output
        told = (tmp_path / str(len(options)) / "truth" / "truth.json").read_text(encoding="utf-8")
        return dict(json.loads(told)["effects"])

    assert effects() == plain(asdict(RealBench()))
    drawn = effects("--effects")
    assert sum(bool(drawn[name]) for name in ("thickness", "relaxation", "slide", "readout", "shake", "droop")) >= 1


def test_faces_in_space_are_turned_rigidly() -> None:
    face = placed_in_space(0.02 * SQUARE, np.array([0.1, 0.05, 0.7, 0.003, 0.2, -0.3]))
    sides = np.linalg.norm(np.roll(face, -1, axis=0) - face, axis=1)
    np.testing.assert_allclose(sides, 0.02)
    np.testing.assert_allclose(face.mean(axis=0), [0.1, 0.05, 0.003])
    along = (face[1] - face[0]) / 0.02
    np.testing.assert_allclose(along, [np.cos(0.3) * np.cos(0.7), np.cos(0.3) * np.sin(0.7), np.sin(-0.3)], atol=1e-12)


def test_a_row_sees_what_is_there_when_it_is_exposed() -> None:
    first, moved = np.array([[10.0, 70.0]]), np.array([[4.0, 6.0]])
    seen = rolled(np.stack([first, first + 0.25 * moved, first + moved]), 100)  # by the square of the time
    np.testing.assert_allclose(seen, first + (seen[0, 1] / 100) ** 2 * moved, atol=1e-3)


def test_a_shake_has_its_size_and_its_band() -> None:
    effects = RealBench(shake=0.3, drift=2.0, shake_band=(3.0, 8.0))
    motion = camera_motion(effects, 10.0, np.random.default_rng(1))
    ends = motion.rate * 10.0
    assert float(np.hypot(*ends)) == pytest.approx(2.0)
    time = np.arange(0.0, 400.0, 0.02)
    shake = motion.shift(time) - time[:, None] * motion.rate
    np.testing.assert_allclose(shake.std(axis=0), 0.3, rtol=0.05)
    power = np.abs(np.fft.rfft(shake[:, 0])) ** 2
    inside = (np.fft.rfftfreq(len(time), 0.02) > 2.9) & (np.fft.rfftfreq(len(time), 0.02) < 8.1)
    assert power[inside].sum() > 0.99 * power.sum()
    assert camera_motion(RealBench(), 10.0, np.random.default_rng(1)).still
