"""Bench readings as people write them down: zeroed gauges, rulers that stand, a good ruler beside a poor tape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from onebend.beam.continuation import follow
from onebend.beam.loads import push, weight
from onebend.beam.problem import make_problem
from onebend.beam.statics import Equilibrium
from onebend.errors import ObservationError, RecordingError
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import Posterior, fit
from onebend.learning.start import start_of
from onebend.learning.validation import validate
from onebend.pipeline import learn
from onebend.recording.observe import observe
from onebend.records import Array, Observations
from onebend.results.observations_file import load_observations, save_observations
from tests.recording.tracked import ROD, ROD_S, pose_folder

pytestmark = pytest.mark.usefixtures("no_other_places")

G, DOWN = 9.81, np.array([0.0, -1.0])
HUNG = np.linspace(0.0, 0.25, 6)  # N at the tip; the first pose is the bare one
LOADS = "pose,s,weight_N\n" + "".join(f"{i},1,{w}\n" for i, w in enumerate(HUNG))
TIMES = 2.0  # as much hangs where rulers stand, so that the rod slides on
LADEN = "pose,s,weight_N\n" + "".join(f"{i},1,{TIMES * w}\n" for i, w in enumerate(HUNG))
FEW = FitSettings(functions=10)
BEAM = 'mass_kg = 0.03\nrest = "straight"\n'
S = np.linspace(0.1, 0.7, 13)
STANDS = np.array([0.1, 0.2, 0.28, 0.36, 0.42])  # m, x of five rulers
ROOM = 'axes = "room"\nclamp_sd_deg = 0.5\n'


def bent(times: float = 1.0) -> Equilibrium:
    """The rod, clamped level, with so many times `HUNG` at its tip."""
    return follow(make_problem(ROD, push(times * HUNG[:, None] * DOWN) + weight(G * DOWN)))


def hanging() -> Array:
    """(6, 5, 2) m: its marks."""
    solved = bent()
    return np.asarray(solved.xy(ROD_S))


def under_rulers(times: float = 1.0) -> Array:
    """(6, 5, 2) m: where the rod passes the rulers, by interpolation on a fine grid."""
    fine = bent(times).xy(np.linspace(0.0, 1.0, 4001))
    y = [np.interp(STANDS, line[:, 0], line[:, 1]) for line in fine]
    return np.stack([np.broadcast_to(STANDS, (6, 5)), np.array(y)], axis=-1)


def noisy(points: Array, sd: float, axis: slice = slice(None), seed: int = 0) -> Array:
    out = points.copy()
    out[..., axis] += sd * np.random.default_rng(seed).normal(size=out[..., axis].shape)
    return out


def seen(folder: Path, shown: Array, poses: str = ROOM, beam: str = BEAM, **options: object) -> Observations:
    given: dict[str, object] = {"loads": LOADS, "shown": shown, "poses": poses, "beam": beam, **options}
    return observe(pose_folder(folder, **given))  # type: ignore[arg-type]


def without_bare(shown: Array) -> Array:
    out = shown.copy()
    out[0] = np.nan
    return out


def zeroed(shown: Array, axes: tuple[int, ...] = (0, 1), sd: float = 0.0) -> Array:
    """Readings that count from the bare pose, whose own error is in all of them."""
    out = noisy(shown, sd, slice(None) if len(axes) == 2 else slice(1, 2))
    out[..., axes] -= out[:1][..., axes]
    return without_bare(out)


def learned(o: Observations) -> Posterior:
    return fit([o], start_of([o], None), settings=FEW)


def check_k(posterior: Posterior, within: float) -> None:
    """k(s) inside its 95 % band, and near."""
    band, true = posterior.band(S), ROD.stiffness(S)
    assert np.all((band.low < true) & (true < band.high))
    assert np.max(np.abs(band.k / true - 1.0)) < within


def test_small_deflections_may_be_read_alone(tmp_path: Path) -> None:
    """The tip goes down by a thousandth of the length: no unit is in doubt, where y is all that was read."""
    o = seen(tmp_path, 1e-3 * hanging()[..., 1:], columns=("y_m",))
    assert np.nanmax(np.abs(o.xy[..., 1])) < 2e-3 * ROD.length
    with pytest.raises(ObservationError, match="in metres"):
        seen(tmp_path, 1e-3 * hanging())


@pytest.mark.slow
def test_zeroed_gauges_tell_k(tmp_path: Path) -> None:
    """Displacements of marks since the bare pose, which itself sags by 5 % of the length and is read by nobody."""
    assert hanging()[0, -1, 1] < -0.04 * ROD.length
    o = seen(tmp_path, zeroed(hanging(), sd=1e-4), ROOM + 'relative_to = "0"\nsd_m = 1e-4\n')
    assert o.readings.bare == 0
    assert np.all(o.xy[0] == 0.0)
    np.testing.assert_allclose(o.covariance[0], o.covariance[1])
    posterior = learned(o)
    check_k(posterior, 0.12)
    zeros = [one.value for one in posterior.nuisances() if "zero of point" in one.name]
    np.testing.assert_allclose(np.reshape(zeros, (5, 2)), hanging()[0], atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("zero", [False, True], ids=["from the clamp", "zeroed"])
def test_rulers_that_stand_read_what_slides_beneath_them(tmp_path: Path, zero: bool) -> None:
    """The rod under them moves on by centimetres: read as marks, the same numbers make no sense."""
    exact = noisy(under_rulers(TIMES), 1e-4, slice(1, 2))
    shown = zeroed(under_rulers(TIMES), (1,), 1e-4) if zero else exact
    poses = ROOM + 'read_at = "x"\nsd_m = 1e-4\n' + ('relative_to = "0"\n' if zero else "")
    o = seen(tmp_path, shown, poses, loads=LADEN)
    np.testing.assert_allclose(o.xy[..., 0], np.broadcast_to(STANDS, (6, 5)))
    posterior = learned(o)
    check_k(posterior, 0.15)
    if not zero:
        as_marks = seen(tmp_path, exact[..., 1:], ROOM + "sd_m = 1e-4\n", columns=("y_m",), loads=LADEN)
        assert learned(replace(as_marks, marker_s=STANDS / ROD.length)).grade == "not to be trusted"


def test_rulers_and_zeros_come_through_validation_and_back_from_disk(tmp_path: Path) -> None:
    poses = ROOM + 'read_at = "x"\nsd_m = 1e-4\nrelative_to = "0"\n'
    folder = pose_folder(tmp_path, loads=LOADS, shown=zeroed(under_rulers(), (1,)), poses=poses, beam=BEAM)
    o = observe(folder)
    compared = validate(ROD, o)
    assert [one.text[:32] for one in o.source.remarks[-2:]] == [
        "The readings count from pose 0, ",
        "The points are rulers that stand",
    ]
    assert np.nanmax(compared.rms) < 1e-6
    np.testing.assert_allclose(compared.predicted, under_rulers(), atol=1e-6)
    save_observations(tmp_path / "o.parquet", o)
    assert load_observations(tmp_path / "o.parquet").readings == o.readings
    run = learn(folder, fitting=FEW, validate_on=[])
    assert run.posterior is not None
    assert run.trainings[0].rms.max() < 1e-3


def test_the_error_of_a_point_goes_before_that_of_all(tmp_path: Path) -> None:
    cells = np.concatenate([hanging(), np.full((6, 5, 1), np.nan)], axis=-1)
    cells[2, 2, 2] = 0.002
    o = seen(tmp_path, cells, ROOM + "sd_m = 0.001\n", columns=("x_m", "y_m", "sd_m"))
    assert o.sd_known
    np.testing.assert_allclose(o.covariance[2, 2, :2, :2], 0.002**2 * np.eye(2))
    np.testing.assert_allclose(o.covariance[2, 3, :2, :2], 0.001**2 * np.eye(2))


@pytest.mark.parametrize(
    ("poses", "words"),
    [
        ('relative_to = "bare"\n', [r"recording.toml:\d+: relative_to names no pose", "It has 0, 1"]),
        ('relative_to = "3"\n', ["poses.csv, line 17", "zeroed in pose 3"]),
        ("sd_m = 0\n", ["sd_m must be a number above 0"]),
        ("error_length_m = -1\n", ["error_length_m must be"]),
        ('read_at = "y"\n', ['one of "mark", "x"']),
    ],
)
def test_wrong_use_is_named(tmp_path: Path, poses: str, words: list[str]) -> None:
    for word in words:
        with pytest.raises(RecordingError, match=word):
            seen(tmp_path, hanging(), ROOM + poses)


def _tilted(table: str) -> str:
    return table.replace("weight_N\n", "weight_N,clamp_deg\n").replace(",0.1\n", ",0.1,5\n")


@pytest.mark.parametrize(
    ("shown", "poses", "loads", "columns", "words"),
    [
        (lambda: hanging()[..., 1:], 'read_at = "x"\n', LOADS, ("y_m",), "line 2: a ruler stands at its x_m"),
        (hanging, 'read_at = "x"\n', LOADS.replace("0,1,0.0", "0,1,unknown"), ("x_m", "y_m"), "weight_N is 'unknown'"),
        (lambda: without_bare(hanging()), 'relative_to = "0"\nread_at = "x"\n', LOADS, ("x_m", "y_m"), "another x_m"),
        (lambda: without_bare(hanging()), 'relative_to = "0"\n', _tilted(LOADS), ("x_m", "y_m"), "stays as it is"),
        (hanging, 'read_at = "x"\n', _tilted(LOADS), ("x_m", "y_m"), "needs a level clamp"),
        (
            hanging,
            'read_at = "x"\n',
            "pose,s,fx_N,fy_N,moment_N_m\n" + "".join(f"{i},1,unknown,unknown,unknown\n" for i in range(6)),
            ("x_m", "y_m"),
            "read_at needs a free end",
        ),
    ],
    ids=["no x", "text", "moved", "turned clamp", "tilted", "held"],
)
def test_what_rulers_and_zeros_cannot_read(
    tmp_path: Path, shown: Callable[[], Array], poses: str, loads: str, columns: tuple[str, ...], words: str
) -> None:
    folder = pose_folder(tmp_path, loads=loads, shown=shown(), poses=ROOM + poses, beam=BEAM, columns=columns)
    with pytest.raises(RecordingError, match=words):
        observe(folder)


def test_a_ruler_where_no_beam_can_be(tmp_path: Path) -> None:
    beyond = under_rulers()
    beyond[..., 4, 0] = 0.52
    with pytest.raises(ObservationError, match=r"ruler of point 5 stands at x = 520 mm"):
        seen(tmp_path, beyond, ROOM + 'read_at = "x"\n')
