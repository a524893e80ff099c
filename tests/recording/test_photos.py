"""Photos of printed tags on a beam under weights: poses, whatever the files' times and the camera's place."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from onebend.beam.continuation import follow
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.problem import make_problem
from onebend.beam.stiffness import Table
from onebend.errors import ObservationError, RecordingError
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import fit
from onebend.learning.start import start_of
from onebend.recording.observe import observe
from onebend.records import Array, View
from tests.recording.filmed import HEIGHT, LENGTH, SIZE, WIDTH, picture, view

pytestmark = pytest.mark.usefixtures("no_other_places")

BEAM = Beam(LENGTH, Table((0.0, 0.5, 1.0), (0.05, 0.03, 0.02)))
S = np.array([0.0, 1 / 3, 2 / 3, 1.0])
FORCE = np.stack([np.zeros(5), [0.0, 0.08, 0.16, 0.24, 0.32]], axis=1)
LOADS = "pose,s,fx_N,fy_N\n" + "".join(f"{i}.png,1,{x},{y}\n" for i, (x, y) in enumerate(FORCE.tolist()))


@cache
def true() -> Array:
    """(5, 4, 3) poses of the base tag and three tags."""
    found = follow(make_problem(BEAM, push(FORCE)))
    return np.asarray(np.concatenate([found.xy(S), found.angle(S)[..., None]], axis=-1))


@cache
def pictures(in_the_hand: bool) -> tuple[np.ndarray, ...]:
    """The five photos, from a tripod or not."""
    out = []
    for i, (poses, look) in enumerate(zip(true(), moved() if in_the_hand else [view()] * 5, strict=True)):
        noise = 1.5 * np.random.default_rng(i).standard_normal((HEIGHT, WIDTH))
        out.append(np.clip(np.rint(picture(poses, range(4), look) + noise), 0, 255).astype(np.uint8))
    return tuple(out)


def folder_of(folder: Path, *, in_the_hand: bool = False, loads: str = LOADS, more: str = "") -> Path:
    (folder / "photos").mkdir(parents=True)
    for i, shown in enumerate(pictures(in_the_hand)):
        Image.fromarray(shown).save(folder / "photos" / f"{i}.png")
    (folder / "loads.csv").write_text(loads)
    tags = "".join(f"[[tags.on_beam]]\nid = {i}\ns = {S[i]}\n" for i in (1, 2, 3))
    matrix, dist = view().matrix, view().dist.tolist()
    camera = (
        f"[camera]\nwidth = {WIDTH}\nheight = {HEIGHT}\nfx = {matrix[0, 0]}\nfy = {matrix[1, 1]}\n"
        f"cx = {matrix[0, 2]}\ncy = {matrix[1, 2]}\ndist = {dist}\n"
    )
    (folder / "recording.toml").write_text(
        f"format = 1\n[beam]\nlength_m = {LENGTH}\n[tags]\nsize_m = {SIZE}\nplacement_sd_m = 0.0002\n"
        f'[[tags.on_base]]\nid = 0\ns = 0.0\n{tags}[photos]\nfolder = "photos"\nloads = "loads.csv"\n{more}'
        f"{camera}"
    )
    return folder


def moved() -> list[View]:
    """A camera in the hand: another place and tilt for each picture."""
    out = []
    for i in range(5):
        turn = Rotation.from_rotvec([0.02 * i, -0.03 * i, 0.05 * (i - 2)]).as_matrix()
        shift = np.array([0.003 * i, -0.002 * i, 0.01 * i])
        out.append(replace(view(), rotation=turn @ view().rotation, translation=view().translation + shift))
    return out


def test_photos_give_the_poses_and_k(tmp_path: Path) -> None:
    o = observe(folder_of(tmp_path))
    assert o.static
    off = o.xy - true()[:, 1:, :2]
    assert np.abs(off).max() < 5e-4  # five pictures of tags of 30 px leave their heights open, alike in all
    assert np.abs(off - off[0]).max() < 1.7e-4
    assert np.abs(o.angle - true()[:, 1:, 2]).max() < 0.01
    np.testing.assert_allclose(o.force, FORCE)
    posterior = fit([o], start_of([o], None), settings=FitSettings(functions=8))
    s = np.linspace(0.1, 0.75, 10)
    band, k = posterior.band(s), BEAM.stiffness(s)
    assert np.all((band.low < k) & (k < band.high))
    assert np.all(np.abs(band.k / k - 1) < 0.15)


def test_a_camera_in_the_hand(tmp_path: Path) -> None:
    o = observe(folder_of(tmp_path, in_the_hand=True, more="camera_moves = true\n"))
    sd = np.sqrt(np.einsum("tmii->tmi", o.covariance))[..., :2]
    assert np.abs((o.xy - true()[:, 1:, :2]) / sd).max() < 5.0
    assert np.abs(o.xy - true()[:, 1:, :2]).max() < 1e-3


@pytest.mark.slow
def test_without_a_bare_picture_the_clamps_direction_is_in_doubt(tmp_path: Path) -> None:
    o = observe(folder_of(tmp_path, loads=LOADS.replace("0.png,1,0.0,0.0\n", "")))
    assert len(o.time) == 4
    assert o.stated.clamp_sd == pytest.approx(np.radians(2.0))
    assert any("bare beam" in remark.text for remark in o.source.remarks)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda f: (f / "photos" / "2.png").unlink(), ["2.png has no picture", "0.png, 1.png"]),
        (lambda f: (f / "photos" / "2.png").write_text("no"), ["cannot be read as a picture"]),
        (lambda f: Image.new("L", (WIDTH, HEIGHT), 90).save(f / "photos" / "2.png"), ["2.png: no base tag"]),
        (
            lambda f: Image.open(f / "photos" / "2.png").resize((2 * WIDTH, 2 * HEIGHT)).save(f / "photos" / "2.png"),
            ["not as large"],
        ),
    ],
    ids=["missing", "no picture", "no tag", "other size"],
)
def test_mistakes_are_named(tmp_path: Path, spoil: object, words: list[str]) -> None:
    folder = folder_of(tmp_path)
    spoil(folder)  # type: ignore[operator]
    with pytest.raises((RecordingError, ObservationError)) as told:
        observe(folder)
    for word in words:
        assert word in str(told.value)


@pytest.mark.parametrize(
    "content",
    [b"", b"\x00\x00\x00\x1cftypheic" + bytes(40), b"no picture at all, heic or not"],
    ids=["empty", "HEIC", "text"],
)
def test_what_is_no_picture_is_said_to_be_none(tmp_path: Path, content: bytes) -> None:
    made = folder_of(tmp_path)
    (made / "photos" / "2.png").write_bytes(content)
    with pytest.raises(RecordingError, match="cannot be read as a picture"):
        observe(made)
