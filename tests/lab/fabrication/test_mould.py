"""Moulds: the cavity that is left in the parts is the design, the parts close, and they fit each other."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings, strategies as st
from manifold3d import Manifold, Mesh64
from typer.testing import CliRunner

from onebend.beam.stiffness import Powers, broken_line
from onebend.cli import app
from onebend.errors import MechanicsError
from onebend.lab.designs import DESIGNS, Design
from onebend.lab.fabrication import (
    BESIDE,
    FREE,
    GROOVE_DEEP,
    GROOVE_WIDE,
    SQUEEZE,
    TAG_PLANE,
    VIEW,
    Mould,
    MouldSettings,
    PrintedPart,
    TagSeat,
    box,
    carriers,
    clamp,
    faces_of,
    mesh_of,
    mould,
    strip,
    write_mesh,
)
from tests.lab.printed import width_at

WITHIN = 0.1  # mm
SMOOTH = MouldSettings(tag_places=())


@cache
def made(name: str, kind: str = "open") -> Mould:
    return mould(DESIGNS[name], replace(SMOOTH, kind=kind))  # type: ignore[arg-type]


def solid(mesh: trimesh.Trimesh) -> Manifold:
    vertices = np.array(mesh.vertices, dtype=float, order="C")  # a copy that may be written to, as manifold3d asks
    found = Manifold(Mesh64(vert_properties=vertices, tri_verts=np.array(mesh.faces, np.uint64, order="C")))
    assert found.volume() == pytest.approx(mesh.volume, rel=1e-6)
    return found


def beam_volume(design: Design) -> float:
    """mm^3, by quadrature."""
    s = np.linspace(0.0, 1.0, 20001)
    return float(1e9 * design.depth * design.length * np.trapezoid(np.asarray(design.width(s)), s))


def filled(found: Mould) -> Manifold:
    """What fills the space inside the printed parts, up to their upper face."""
    walls = Manifold()
    for part in found.parts:
        walls += solid(part.mesh)
    x0, y0, z0, x1, y1, z1 = walls.bounding_box()
    hollow = Manifold.cube((x1 - x0 - 1.0, y1 - y0 - 1.0, z1 - z0 - 1.0)).translate((x0 + 0.5, y0 + 0.5, z0 + 1.0))
    inside = [body for body in (hollow - walls).decompose() if body.volume() > 1e3]  # not the holes for screws
    assert len(inside) == 1
    return inside[0]


@pytest.mark.parametrize("kind", ["open", "halves"])
@pytest.mark.parametrize("name", ["linear", "quadratic", "cubic"])
def test_the_cavity_has_the_designs_width_and_volume(name: str, kind: str) -> None:
    found, design = made(name, kind), DESIGNS[name]
    cavity = filled(found)
    mesh = mesh_of(cavity)
    for s in (0.002, 0.1, 0.25, 0.5, 0.77, 0.9, 0.998):
        for z in (0.313, 15.137, 29.713):
            low, high = width_at(mesh, 150.0 * s, z)
            assert high - low == pytest.approx(1e3 * float(design.width(s)), abs=WITHIN)
            assert high + low == pytest.approx(0.0, abs=1e-9)
    assert cavity.bounding_box()[5] - cavity.bounding_box()[2] == pytest.approx(30.0)
    assert cavity.bounding_box()[3] == pytest.approx(150.0)
    free = cavity.trim_by_plane((1.0, 0.0, 0.0), 0.0)
    assert free.volume() == pytest.approx(beam_volume(design), rel=1e-4)
    assert found.volume * 1e9 == pytest.approx(cavity.volume(), rel=1e-6)
    assert found.pour == pytest.approx(design.density * cavity.volume() * 1e-9, rel=1e-6)


@pytest.mark.parametrize("kind", ["open", "halves"])
def test_parts_are_watertight_single_bodies(kind: str) -> None:
    found = made("cubic", kind)
    assert len(found.parts) == (1 if kind == "open" else 2)
    for part in (*found.parts, *clamp(found.design, SMOOTH)):
        assert part.mesh.is_watertight
        assert part.mesh.is_winding_consistent
        assert part.mesh.body_count == 1
        assert part.mesh.volume > 0.0


def test_halves_meet_without_overlapping_and_their_pegs_find_their_holes() -> None:
    left, right = (solid(part.mesh) for part in made("linear", "halves").parts)
    assert (left ^ right).volume() == pytest.approx(0.0, abs=1e-6)
    assert left.bounding_box()[1] == pytest.approx(-4.0)  # pegs reach over the parting plane
    assert right.bounding_box()[4] == pytest.approx(0.0, abs=1e-9)
    for turned in (right.translate((0.1, 0.0, 0.0)), right.translate((0.0, 0.0, -0.1))):
        assert (left ^ turned).volume() < 1e-6  # within the play
    assert (left ^ right.translate((0.3, 0.0, 0.0))).volume() > 0.1  # beyond it the pegs hold


def test_the_wall_is_nowhere_thinner_than_asked() -> None:
    found = mould(DESIGNS["cubic"], replace(SMOOTH, wall=0.003))
    outer, cavity = np.array(solid(found.parts[0].mesh).bounding_box()), np.array(filled(found).bounding_box())
    assert np.all(cavity[[0, 1, 2]] - outer[[0, 1, 2]] >= 3.0 - 1e-9)
    assert np.all(outer[[3, 4]] - cavity[[3, 4]] >= 3.0 - 1e-9)


def test_draft_opens_the_cavity_upwards_and_keeps_the_width_at_half_the_depth() -> None:
    design, draft = DESIGNS["quadratic"], math.radians(2.0)
    mesh = mould(design, replace(SMOOTH, draft=draft)).cast
    for s in (0.2, 0.6):
        w = 1e3 * float(design.width(s))
        for z in (1.0, 15.0 + 1e-6, 29.0):
            low, high = width_at(mesh, 150.0 * s, z)
            assert high - low == pytest.approx(w + 2.0 * math.tan(draft) * (z - 15.0), abs=1e-3)


def test_shrinkage_makes_the_mould_larger_and_the_cast_right() -> None:
    plain, grown = made("linear"), mould(DESIGNS["linear"], replace(SMOOTH, shrinkage=0.01))
    assert grown.cast.volume == pytest.approx(plain.cast.volume, rel=1e-12)
    assert filled(grown).volume() == pytest.approx(plain.cast.volume / 0.99**3, rel=1e-6)
    assert grown.volume == pytest.approx(plain.volume / 0.99**3, rel=1e-9)


def test_grooves_mark_the_tags() -> None:
    design = DESIGNS["linear"]
    found = mould(design, MouldSettings(tag_places=(1 / 3, 2 / 3, 1.0)))
    lost = made("linear").cast.volume - found.cast.volume
    widths = sum(1e3 * float(design.width(s)) for s in (1 / 3, 2 / 3))
    assert lost == pytest.approx(GROOVE_WIDE * GROOVE_DEEP * widths, rel=1e-3)
    assert len(width_at(found.cast, 50.0, 0.5 * GROOVE_DEEP)) == 0
    assert len(width_at(found.cast, 51.0, 0.5 * GROOVE_DEEP)) == 2
    assert solid(found.parts[0].mesh).volume() == pytest.approx(made("linear").parts[0].mesh.volume + lost, rel=1e-9)


def test_the_clamp_holds_the_foot_and_leaves_the_beam_free() -> None:
    design = DESIGNS["linear"]
    lower, cap = (solid(part.mesh) for part in clamp(design, SMOOTH))
    beam = solid(made("linear").cast)
    assert (lower ^ beam).volume() == pytest.approx(0.0, abs=1e-3)
    assert (lower ^ cap).volume() == pytest.approx(0.0, abs=1e-6)
    pressed = cap ^ beam
    assert 0.0 < pressed.volume() < SQUEEZE * 20.0 * 18.0
    assert pressed.bounding_box()[3] <= -3.0  # in the foot alone
    free = beam.trim_by_plane((1.0, 0.0, 0.0), 1.0)
    assert free.min_gap(cap, 5.0) == pytest.approx(FREE, abs=1e-6)
    pulled = beam.translate((0.5, 0.0, 0.0))
    assert (lower ^ pulled).volume() > 10.0  # the shoulders hold it back
    assert lower.bounding_box()[3] == pytest.approx(0.0, abs=1e-9)  # its face is the clamp line s = 0


def test_all_tags_lie_in_one_plane_over_their_places() -> None:
    design, seat = DESIGNS["linear"], TagSeat(0.012)
    (_, cap), plates = clamp(design, SMOOTH, seat), carriers(design, MouldSettings(), seat)
    top = 30.0 + TAG_PLANE
    floors = [
        face[:, :2] for face in cap.mesh.triangles if np.allclose(face[:, 2], top) and np.max(np.abs(face[:, :2])) < 8.0
    ]
    corners = np.concatenate(floors)
    np.testing.assert_allclose(corners.min(axis=0), [-7.6, -7.6], atol=1e-6)  # 15 mm and its play, about s = 0
    np.testing.assert_allclose(corners.max(axis=0), [7.6, 7.6], atol=1e-6)
    assert plates.mesh.body_count == 3
    for body in plates.mesh.split():
        heights = np.unique(np.round(body.vertices[:, 2], 6))
        assert heights[0] == 0.0
        assert TAG_PLANE in heights
    last = max(plates.mesh.split(), key=lambda body: float(body.bounds[1, 0]))
    foot = last.vertices[last.vertices[:, 2] < 0.5]
    middle = float(last.bounds[:, 0].mean())
    assert foot[:, 0].max() - middle == pytest.approx(0.0, abs=1e-6)  # at the tip the stem stays on the beam


def test_a_large_tag_keeps_clear_of_the_screws() -> None:
    seat = TagSeat(0.03)
    _, cap = clamp(DESIGNS["linear"], SMOOTH, seat)
    assert cap.mesh.extents[1] >= seat.recess + 2.0 * BESIDE


@settings(max_examples=10, deadline=None)
@given(
    length=st.floats(0.06, 0.4),
    depth=st.floats(0.01, 0.05),
    widths=st.lists(st.floats(0.004, 0.03), min_size=2, max_size=5),
    kind=st.sampled_from(["open", "halves"]),
    draft=st.floats(0.0, 0.02),
)
def test_any_design_makes_parts_that_close(
    length: float, depth: float, widths: list[float], kind: Any, draft: float
) -> None:
    s = tuple(np.linspace(0.0, 1.0, len(widths)).tolist())
    design = Design("any", length, depth, broken_line(s, tuple(widths)), 1e6, 0.0, 1080.0)
    found = mould(design, replace(SMOOTH, kind=kind, draft=draft))
    assert all(part.mesh.is_watertight for part in found.parts)
    middle = 0.5e3 * depth * (1.0 + 1e-6)
    low, high = width_at(found.cast, 1e3 * length * 0.37, middle)
    assert high - low == pytest.approx(1e3 * float(design.width(0.37)), abs=0.02)


@pytest.mark.parametrize("suffix", [".stl", ".3mf"])
def test_files_hold_the_part_in_millimetres(tmp_path: Path, suffix: str) -> None:
    part = made("linear").parts[0]
    path = tmp_path / f"part{suffix}"
    write_mesh(path, part.mesh)
    loaded = trimesh.load_mesh(path)
    again = loaded if isinstance(loaded, trimesh.Trimesh) else loaded.to_mesh()
    again.merge_vertices()
    assert again.is_watertight
    np.testing.assert_allclose(again.extents, part.mesh.extents, atol=1e-4)
    assert again.volume == pytest.approx(part.mesh.volume, rel=1e-5)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"wall": 0.0}, "wall must be positive"),
        ({"draft": 0.3}, "0 to 10 degrees"),
        ({"shrinkage": 0.5}, "from 0 to 0.1"),
        ({"tag_places": (0.0,)}, r"s in \(0, 1\]"),
    ],
)
def test_moulds_that_cannot_be_are_refused(change: dict[str, Any], says: str) -> None:
    with pytest.raises(MechanicsError, match=says):
        MouldSettings(**change)


def test_a_draft_that_closes_the_cavity_is_refused() -> None:
    thin = Design("thin", 0.15, 0.03, Powers((0.004,)), 1e6, 0.0, 1080.0)
    with pytest.raises(MechanicsError, match="less draft"):
        mould(thin, MouldSettings(draft=math.radians(9.0)))
    with pytest.raises(MechanicsError, match="less draft"):
        strip(np.array([[0.0, 1.0], [0.0, 1.0]]), np.array([[0.0, 1.0], [1.0, 1.0]]), 0.0, 1.0)
    with pytest.raises(MechanicsError, match="do not fit side by side"):
        carriers(DESIGNS["linear"], MouldSettings(tag_places=(0.5, 0.55)))


def test_a_picture_shows_the_sides_that_are_seen() -> None:
    """A box from above, in front and at its side: three faces of six, whose areas are those of the projection."""
    mesh = mesh_of(box((0.0, 0.0, 0.0), (3.0, 2.0, 1.0)))
    polygons = np.array([np.asarray(path.vertices)[:3] for path in faces_of(PrintedPart("box", mesh)).get_paths()])
    assert len(polygons) == 6
    edges = polygons[:, 1:] - polygons[:, :1]
    areas = 0.5 * np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    toward = np.abs(VIEW) / np.linalg.norm(VIEW)
    assert areas.sum() == pytest.approx(toward @ [2.0 * 1.0, 3.0 * 1.0, 3.0 * 2.0])


def test_the_command_writes_the_parts(tmp_path: Path) -> None:
    out, picture = tmp_path / "parts", tmp_path / "p.png"
    asked = ["mould", "quadratic", "-o", str(out), "--kind", "halves", "--tag-at", "0.5", "--tag-at", "1"]
    done = CliRunner().invoke(app, [*asked, "--picture", str(picture), "--json"])
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    names = {"mould-left", "mould-right", "clamp-lower", "clamp-cap", "carriers", "cast-beam"}
    assert set(said["parts"]) == names
    assert {path.name for path in out.iterdir()} == {f"{name}.stl" for name in names} | {"summary.json"}
    assert trimesh.load_mesh(out / "carriers.stl").body_count == 2
    assert picture.read_bytes().startswith(b"\x89PNG")
    again = CliRunner().invoke(app, ["mould", "quadratic", "-o", str(out)])
    assert again.exit_code == 2
    assert "already holds results" in again.stderr
    replaced = CliRunner().invoke(app, ["mould", "quadratic", "-o", str(out), "--as", "3mf", "--force"])
    assert replaced.exit_code == 0, replaced.output
    assert "Pour" in replaced.stdout
    assert not list(out.glob("*.stl"))
