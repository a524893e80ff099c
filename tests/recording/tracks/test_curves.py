"""Curves from a tracker or drawn by hand: vertices in their order, of which nobody knows the place along the body."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from onebend.beam.continuation import follow
from onebend.beam.loads import push, weight
from onebend.beam.problem import make_problem
from onebend.errors import OnebendError
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import fit
from onebend.recording.folder import read_recording
from onebend.recording.observe import observe
from onebend.recording.outline import PLACES, POINTS
from onebend.recording.tracks import points_on, track_markers
from onebend.records import Array
from onebend.report.figures import check_png
from onebend.report.overview import overview
from tests.made_up import BEAM, LENGTH
from tests.recording.pushed import Pushed, force_at, push as pushed
from tests.recording.tracked import ROD, write_log

pytestmark = pytest.mark.usefixtures("no_other_places")

PUSHED = Pushed()
S = np.linspace(0.0, 1.0, 41)
NOISE = 3e-5  # m, of a vertex
SHIFT, TURN = np.array([0.3, 0.2]), 0.4


@cache
def filmed() -> tuple[Array, Array, Array]:
    """(T,) s, and (T, 41, 2) m and (T, 41) rad of the body in each frame of a push."""
    time = np.arange(0.0, PUSHED.film, 1.0 / PUSHED.fps)
    part = np.linspace(0.0, 1.0, 100)
    shape = BEAM.equilibrium(force_at(part), np.ones(100))
    now = pushed(time, rise=PUSHED.rise, hold=PUSHED.hold)
    xy = np.stack([np.interp(now, part, one) for one in shape.xy(S).reshape(100, -1).T], axis=1)
    angle = np.stack([np.interp(now, part, one) for one in shape.angle(S).T], axis=1)
    return time, xy.reshape(len(time), len(S), 2), angle


def film_folder(folder: Path, *, markers: str = "", rows: str = "") -> Path:
    """The push of `Pushed` as a tracker's curves, in a plane of its own."""
    folder.mkdir(exist_ok=True)
    time, xy, _ = filmed()
    turn = np.array([[np.cos(TURN), np.sin(TURN)], [-np.sin(TURN), np.cos(TURN)]])
    seen = (xy + NOISE * np.random.default_rng(0).normal(size=xy.shape)) @ turn + SHIFT
    lines = ["time_s,id,order,x_m,y_m"]
    for t, curve in zip(time, seen, strict=True):
        lines += [f"{t:.6f},,{i},{x:.8f},{y:.8f}" for i, (x, y) in enumerate(curve.tolist())]
    (folder / "curves.csv").write_text("\n".join(lines) + f"\n{rows}")
    write_log(folder, PUSHED)
    (folder / "recording.toml").write_text(
        f'format = 1\n[beam]\nlength_m = {LENGTH}\n[markers]\nfile = "curves.csv"\n'
        f"start_s = {PUSHED.offset}\nstart_uncertainty_s = 0.0\n{markers}"
        '[force]\nfile = "force.csv"\n[push]\nat_s = 1.0\n'
    )
    return folder


CLAMP = f"clamp_m = {SHIFT.tolist()}\nx_axis = [{np.cos(TURN)}, {np.sin(TURN)}]\n"


@pytest.mark.slow
@pytest.mark.parametrize("markers", [CLAMP, ""], ids=["clamp stated", "from rest"])
def test_a_trackers_curve_is_points_that_are_free_along_it(tmp_path: Path, markers: str) -> None:
    found = track_markers(read_recording(film_folder(tmp_path, markers=markers)))
    _, xy, angle = filmed()
    assert found.traced is not None
    assert found.traced.all()
    np.testing.assert_array_equal(found.s, PLACES)
    true = np.stack([[np.interp(PLACES, S, one) for one in frame.T] for frame in xy]).swapaxes(1, 2)
    normal = np.stack([-np.sin(found.angle), np.cos(found.angle)], axis=-1)
    assert float(np.abs(np.sum((found.xy - true) * normal, axis=-1)).max()) < 2.5e-4
    assert float(np.abs(found.angle - [np.interp(PLACES, S, one) for one in angle]).max()) < 0.05
    assert 0.4 * NOISE < float(np.sqrt(np.median(found.covariance[..., 0, 0]))) < 1.5 * NOISE


@pytest.mark.slow
def test_k_is_learned_from_a_trackers_curve(tmp_path: Path) -> None:
    o = observe(film_folder(tmp_path, markers=CLAMP))
    s = np.linspace(0.1, 0.8, 15)
    band, k = fit([o], settings=FitSettings(functions=12, most_frames=40, first_frames=20)).band(s), BEAM.stiffness(s)
    assert float(np.sqrt(np.mean(np.log(band.k / k) ** 2))) < 0.1
    assert float(np.mean((band.low < k) & (k < band.high))) > 0.9


def test_markers_may_stand_beside_the_curve(tmp_path: Path) -> None:
    """A base marker in the same table shows the clamp's place."""
    rows = "".join(f"{t:.6f},7,,{SHIFT[0]},{SHIFT[1]}\n" for t in filmed()[0])
    folder = film_folder(tmp_path, rows=rows)
    file = folder / "recording.toml"
    file.write_text(file.read_text().replace("[markers]", "[tags]\n[[tags.on_base]]\nid = 7\n[markers]"))
    found = track_markers(read_recording(folder))
    assert float(np.abs(found.xy[0, :, 1]).max()) < 2.5e-4


def test_points_of_a_circle_lie_on_it() -> None:
    """Few vertices are joined by a smooth curve, many are averaged; a curve that ends early says nothing beyond."""
    for count, end in ((7, 1.0), (40, 1.0), (400, 1.0), (40, 0.6)):
        turn = np.linspace(0.0, 1.2 * end, count)
        circle = 0.1 / 1.2 * np.stack([np.sin(turn), 1.0 - np.cos(turn)], axis=1)
        points = points_on(circle[None], 0.1, "circle")
        seen = np.isfinite(points.xy[0, :, 0])
        np.testing.assert_array_equal(seen, end + 1e-9 > PLACES)
        radius = np.linalg.norm(points.xy[0, seen] - [0.0, 0.1 / 1.2], axis=1)
        assert float(np.abs(radius - 0.1 / 1.2).max()) < 2e-5
        assert float(np.abs(points.angle[0, seen] - 1.2 * PLACES[seen]).max()) < 2e-3
        assert points.share[0] == max(count / POINTS, 1.0)


@cache
def hung() -> Array:
    """(3, 41, 2) m: the rod under its own weight, bare and with two forces at its tip."""
    force = np.array([[0.0, 0.0], [0.0, -0.15], [0.05, -0.3]])
    loads = push(force) + weight(np.tile([0.0, -9.81], (3, 1)))
    return follow(make_problem(ROD, loads)).xy(S)


def pose_folder(folder: Path, *, poses: str = "", rows: str = "", length: float = ROD.length) -> Path:
    """The three shapes as curves drawn by hand, whose errors are smooth along them."""
    folder.mkdir(exist_ok=True)
    rng, lines = np.random.default_rng(1), ["pose,order,x_m,y_m,id"]
    for p, xy in enumerate(hung()):
        wave = 5e-4 * rng.normal() * np.sin(4.0 * S + rng.uniform(0.0, 6.0)) * S
        points = xy + np.stack([np.zeros(len(S)), wave], axis=1) + 1e-4 * rng.normal(size=xy.shape)
        lines += [f"{p},{i},{x:.7f},{y:.7f}," for i, (x, y) in enumerate(points.tolist())]
    (folder / "poses.csv").write_text("\n".join(lines) + f"\n{rows}")
    (folder / "loads.csv").write_text("pose,s,fx_N,fy_N\n0,,,\n1,1,0,-0.15\n2,1,0.05,-0.3\n")
    (folder / "recording.toml").write_text(
        f'format = 1\n[beam]\nlength_m = {length}\nmass_kg = 0.03\nmass_along = "even"\nrest = "straight"\n'
        f'[poses]\nfile = "poses.csv"\nloads = "loads.csv"\naxes = "room"\n{poses}'
        "[gravity]\ndirection_deg = -90\nbase_angle_deg = 0\n"
    )
    return folder


@pytest.mark.slow
def test_curves_of_static_poses(tmp_path: Path) -> None:
    o = observe(pose_folder(tmp_path))
    assert o.static
    assert not o.sd_known
    assert o.readings.error_length == pytest.approx(0.1)
    s = np.linspace(0.1, 0.8, 15)
    band, k = fit([o]).band(s), ROD.stiffness(s)
    assert float(np.sqrt(np.mean(np.log(band.k / k) ** 2))) < 0.1
    assert float(np.mean((band.low < k) & (k < band.high))) > 0.9


def _swap(old: str, new: str) -> Callable[[Path], object]:
    def change(folder: Path) -> None:
        for file in (folder / "recording.toml", folder / "poses.csv"):
            file.write_text(file.read_text().replace(old, new))

    return change


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_swap("0,3,", "0,2,"), ["poses.csv, line 5", "order is there twice"]),
        (_swap("0,3,", "0,,"), ["poses.csv, line 5", "neither id nor order"]),
        (_swap("pose,order", "pose,number"), ["poses.csv", "order", "Rename it"]),
        (_swap("length_m = 0.5", "length_m = 0.05"), ["long, the body 50 mm", "metres"]),
        (_swap('axes = "room"', 'axes = "room"\nread_at = "x"'), ["recording.toml:", "read_at is of points"]),
        (_swap("[poses]", "[[points]]\nid = 1\ns = 0.5\n[poses]"), []),
    ],
    ids=["twice", "no order", "no column", "length", "rulers", "points unseen"],
)
def test_mistakes_are_named(tmp_path: Path, spoil: Callable[[Path], object], words: list[str]) -> None:
    folder = pose_folder(tmp_path)
    spoil(folder)
    if not words:
        assert observe(folder).traced is not None
        return
    with pytest.raises(OnebendError) as told:
        observe(folder)
    for word in words:
        assert word in str(told.value)


def test_check_draws_curves(tmp_path: Path) -> None:
    for folder in (film_folder(tmp_path / "film", markers=CLAMP), pose_folder(tmp_path / "poses")):
        drawn = check_png(overview(folder))
        assert drawn is not None
        assert drawn.startswith(b"\x89PNG")
