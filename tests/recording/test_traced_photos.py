"""Photos of a body without tags that its own weight bends: its curve in the picture, its length as the scale."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw

from onebend.beam.continuation import follow
from onebend.beam.loads import weight
from onebend.beam.model import Beam
from onebend.beam.problem import make_problem
from onebend.beam.stiffness import Uniform
from onebend.errors import ObservationError, OnebendError
from onebend.learning.posterior import fit
from onebend.learning.validation import validate
from onebend.recording.folder import read_recording
from onebend.recording.observe import observe
from onebend.recording.photos import level_view, photo_observations
from onebend.recording.plane import project
from onebend.recording.template import write_template
from onebend.records import Array, View
from onebend.report.figures import check_png
from onebend.report.overview import overview
from onebend.report.verdict import validation_verdict
from tests.recording.filmed import HEIGHT, SIZE, WIDTH, picture, view

pytestmark = pytest.mark.usefixtures("no_other_places")

LENGTH, MASS, K, HALF = 0.12, 0.02, 0.011, 0.003
G = 9.81
BODY, GROUND = (170, 60, 50), (40, 45, 60)
FINE = np.linspace(0.0, 1.0, 4001)
CLICKED = (0.0, 0.3, 0.65, 1.0)
ORIGIN, SCALE, TURN = (
    np.array([101.3, 60.7]),
    3900.0,
    0.2,
)  # px, px/m, rad: a level picture and how the clamp rises in it


@cache
def shape(turn: float = TURN) -> tuple[Array, Array]:
    """(n, 2) m and (n,) rad: the body under its weight, clamped at `turn` against the level."""
    body = Beam(LENGTH, Uniform(K), mass_per_length=Uniform(MASS / LENGTH))
    down = -np.pi / 2 - turn
    found = follow(make_problem(body, weight(G * np.array([[np.cos(down), np.sin(down)]]))))
    return found.xy(FINE)[0], found.angle(FINE)[0]


def painted(
    seen: View,
    under: Array | None = None,
    *,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    turn: float = TURN,
    half: float = HALF,
) -> Image.Image:
    """The body in a picture, before the grey picture `under` or a plain ground, with noise."""
    times = 10
    xy, angle = shape(turn)
    normal = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    flanks = np.concatenate([xy + half * normal, (xy - half * normal)[::-1]])
    mask = Image.new("L", (times * size[0], times * size[1]), 0)
    ImageDraw.Draw(mask).polygon([tuple(one) for one in ((project(seen, flanks) + 0.5) * times - 0.5).tolist()], 255)
    share = np.asarray(mask.reduce(times), float)[..., None] / 255.0
    ground = np.ones((size[1], size[0], 1)) * GROUND if under is None else under[..., None] * np.ones(3)
    noise = 1.5 * np.random.default_rng(0).standard_normal(ground.shape)
    return Image.fromarray(np.clip(np.rint(share * BODY + (1.0 - share) * ground + noise), 0, 255).astype(np.uint8))


def folder_of(folder: Path, image: Image.Image, seen: View, *, tags: str = "", off: float = 0.0) -> Path:
    """A recording of one photo; the clicks lie up to `off` px beside the middle."""
    (folder / "photos").mkdir(parents=True)
    image.save(folder / "photos" / "a.png")
    (folder / "loads.csv").write_text("pose,s,mass_kg\na.png,,\n")
    at = [int(s * (len(FINE) - 1)) for s in CLICKED]
    px = project(seen, shape()[0][at]) + off * np.array([[0.0, 0.0], [0.3, 1.0], [-0.5, -1.0], [0.0, 0.0]])
    (folder / "clicks.csv").write_text("pose,x_px,y_px\n" + "".join(f"a.png,{x},{y}\n" for x, y in px.tolist()))
    (folder / "recording.toml").write_text(
        f'format = 1\n[beam]\nlength_m = {LENGTH}\nmass_kg = {MASS}\nrest = "straight"\nmass_along = "even"\n'
        f'stiffness_along = "even"\n{tags}[photos]\nfolder = "photos"\nloads = "loads.csv"\nclicks = "clicks.csv"\n'
        f"[gravity]\ndirection_deg = -90\nbase_angle_deg = {np.degrees(TURN)}\n"
    )
    return folder


LEVEL = level_view(ORIGIN, SCALE, TURN)


def test_a_level_view_is_a_plain_similarity() -> None:
    points = np.array([[0.0, 0.0], [0.02, 0.0], [0.0, 0.01]])
    cos, sin = np.cos(TURN), np.sin(TURN)
    room = points @ np.array([[cos, sin], [-sin, cos]])
    np.testing.assert_allclose(project(LEVEL, points), ORIGIN + SCALE * room * [1.0, -1.0], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("off", [0.0, 3.0])
def test_the_curve_lies_on_the_body_and_k_follows_from_its_weight(tmp_path: Path, off: float) -> None:
    folder = folder_of(tmp_path / "one", painted(LEVEL), LEVEL, off=off)
    o, (curve,) = photo_observations(read_recording(folder))
    true = project(LEVEL, shape()[0])
    away = np.linalg.norm(curve.px[0][:, None] - true, axis=2).min(axis=1)[np.isfinite(curve.sd[0])]
    assert len(away) >= 27
    assert float(np.max(away)) < 0.15  # px
    seen = np.isfinite(o.xy[0, :, 0])
    assert float(np.max(np.linalg.norm(o.xy[0, :, None] - shape()[0], axis=2).min(axis=1)[seen])) < 2e-4
    band = fit([observe(folder)]).band(np.array([0.3]))
    assert band.low[0] < K < band.high[0]
    assert abs(np.log(band.k[0] / K)) < 0.05


def test_two_clicks_are_enough_for_a_body_of_its_own_colour(tmp_path: Path) -> None:
    """The straight line between them leaves the body: what has the colour of the clicked pixels is the body."""
    thin = 0.001
    folder = folder_of(tmp_path / "two", painted(LEVEL, half=thin), LEVEL)
    rows = (folder / "clicks.csv").read_text().splitlines()
    (folder / "clicks.csv").write_text("\n".join([rows[0], rows[1], rows[-1]]) + "\n")
    _, (curve,) = photo_observations(read_recording(folder))
    true = project(LEVEL, shape()[0])
    chord = true[0] + FINE[:, None] * (true[-1] - true[0])
    assert float(np.max(np.linalg.norm(chord[:, None] - true[::40], axis=2).min(axis=0))) > 4.0 * SCALE * thin
    away = np.linalg.norm(curve.px[0][:, None] - true, axis=2).min(axis=1)[np.isfinite(curve.sd[0])]
    assert float(np.max(away)) < 0.15


@pytest.mark.slow
def test_the_scale_is_the_bodys_own_length(tmp_path: Path) -> None:
    """The same body in a picture three times as large, which is made smaller before its edges are looked for."""
    large = level_view(3.0 * ORIGIN, 3.0 * SCALE, TURN)
    image = painted(large, size=(3 * WIDTH, 3 * HEIGHT))
    o, _ = photo_observations(read_recording(folder_of(tmp_path / "large", image, large)))
    seen = np.isfinite(o.xy[0, :, 0])
    assert float(np.max(np.linalg.norm(o.xy[0, :, None] - shape()[0], axis=2).min(axis=1)[seen])) < 2e-4


def test_beside_a_tag_the_camera_may_look_from_anywhere_and_the_clamp_may_be_turned(tmp_path: Path) -> None:
    """The tags give plane, scale and direction in each picture; the first click says where the body begins."""
    tags = np.array([[0.02, -0.045, -TURN], [0.11, 0.035, -TURN]])
    matrix, other = view().matrix, 0.7  # rad, of the clamp in the second picture
    table = f"[tags]\nsize_m = {SIZE}\n[[tags.on_base]]\nid = 0\nturn_deg = {-np.degrees(TURN)}\n"
    table += f"[[tags.on_base]]\nid = 1\nturn_deg = {-np.degrees(TURN)}\n[camera]\nwidth = {WIDTH}\n"
    table += f"height = {HEIGHT}\nfx = {matrix[0, 0]}\nfy = {matrix[1, 1]}\ncx = {matrix[0, 2]}\ncy = {matrix[1, 2]}\n"
    plain = view(dist=(0.0,) * 5)
    folder = folder_of(
        tmp_path / "tag", painted(plain, picture(tags, (0, 1), plain)), plain, tags=table + "dist = [0, 0, 0, 0]\n"
    )
    cos, sin = np.cos(other - TURN), np.sin(other - TURN)
    turned = replace(plain, rotation=plain.rotation @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]))
    painted(turned, picture(tags, (0, 1), turned), turn=other).save(folder / "photos" / "b.png")
    px = project(turned, shape(other)[0][[0, 1200, 2600, 4000]])
    with (folder / "clicks.csv").open("a") as clicks:
        clicks.writelines(f"b.png,{x},{y}\n" for x, y in px.tolist())
    (folder / "loads.csv").write_text(f"pose,s,mass_kg,clamp_deg\na.png,,,\nb.png,,,{np.degrees(other)}\n")
    o = observe(folder)
    for xy, turn in zip(o.xy, (TURN, other), strict=True):
        off = np.linalg.norm(xy[:, None] - shape(turn)[0], axis=2).min(axis=1)[np.isfinite(xy[:, 0])]
        assert len(off) >= 25
        assert float(np.max(off)) < 6e-4
    band = fit([o]).band(np.array([0.3]))
    assert band.low[0] < K < band.high[0]


def _clicks(rows: str) -> Callable[[Path], object]:
    return lambda f: (f / "clicks.csv").write_text(f"pose,x_px,y_px,s\n{rows}")


def _swap(old: str, new: str) -> Callable[[Path], object]:
    def change(folder: Path) -> None:
        file = folder / "recording.toml"
        file.write_text(file.read_text().replace(old, new))

    return change


TAG = "[tags]\nsize_m = 0.01\n[[tags.on_base]]\nid = 0\n"


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_clicks("a.png,100,60,\n"), ["a.png has 1 clicks", "the last at its tip"]),
        (_clicks("a.png,100,60,\nb.png,100,60,\n"), ["clicks.csv, line 3", "not in loads.csv"]),
        (_clicks("a.png,100,60,\na.png,100,60.2,\n"), ["clicks.csv, line 3", "where the one before is"]),
        (_clicks("a.png,100,60,0.5\na.png,300,60,\n"), ["clicks.csv, line 2", "the last click alone"]),
        (_clicks("a.png,100,60,\na.png,300,60,1.5\n"), ["clicks.csv, line 3", "at most 1"]),
        (_clicks("a.png,100,\na.png,300,60,\n"), ["clicks.csv, line 2", "needs x_px and y_px"]),
        (_clicks("a.png,400,250,\na.png,600,300,\n"), ["a.png: no body is seen along the clicks", "upright"]),
        (_swap("base_angle_deg", "# "), ["base_angle_deg"]),
        (_swap('clicks = "clicks.csv"', ""), ["lacks the table [tags]", "`clicks` to [photos]"]),
        (_swap("[photos]", f"{TAG}[[tags.on_beam]]\nid = 1\ns = 1\n[photos]"), ["clicks are of a body without tags"]),
    ],
    ids=["one", "pose", "twice", "early s", "s", "half", "elsewhere", "direction", "no tags", "both"],
)
def test_mistakes_are_named(tmp_path: Path, spoil: Callable[[Path], object], words: list[str]) -> None:
    folder = folder_of(tmp_path / "one", painted(LEVEL), LEVEL)
    spoil(folder)
    with pytest.raises(OnebendError) as told:
        observe(folder)
    for word in words:
        assert word in str(told.value)


def test_a_curve_that_ends_before_the_last_click_is_refused(tmp_path: Path) -> None:
    image = np.array(painted(LEVEL))
    cut = project(LEVEL, shape()[0][[3400]])[0]
    image[:, int(cut[0]) :] = GROUND
    with pytest.raises(ObservationError, match="edges end before its tip"):
        observe(folder_of(tmp_path / "cut", Image.fromarray(image), LEVEL))


@pytest.mark.slow
def test_a_photo_alone_validates_a_beam(tmp_path: Path) -> None:
    """A pose alone has no motion: a miss is counted from the straight beam."""
    o = observe(folder_of(tmp_path / "one", painted(LEVEL), LEVEL))
    said = validation_verdict([validate(Beam(LENGTH, Uniform(K), mass_per_length=Uniform(MASS / LENGTH)), o)])
    assert "shapes are predicted to" in said


def test_check_draws_the_curve_on_the_photo(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "one", painted(LEVEL), LEVEL)
    found = overview(folder)
    assert found.faults == ()
    assert len(found.curves) == 1
    drawn = check_png(found)
    assert drawn is not None
    assert drawn.startswith(b"\x89PNG")


def test_a_new_folder_lists_the_photos(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").write_bytes(b"")
    text = write_template(tmp_path, "photo").read_text()
    assert 'clicks = "clicks.csv"' in text
    assert "tags" not in text.replace("without tags", "")
    assert (tmp_path / "clicks.csv").read_text() == "pose,x_px,y_px\na.jpg,,\n"
    assert (tmp_path / "loads.csv").read_text() == "pose,s,mass_kg\na.jpg,,\n"
