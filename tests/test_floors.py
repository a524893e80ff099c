"""Layers import downwards only, and so do the rooms inside a layer; rooms on one floor do not know each other."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "src" / "onebend"

# From the lowest floor up. A name is a folder, or a module, of the layer.
LAYERS: tuple[tuple[str, ...], ...] = (
    ("errors", "progress", "blas", "lazy", "workers", "strict_json", "escaping"),
    ("text_files", "extras"),
    ("records", "files", "crash"),
    ("beam",),
    ("recording",),
    ("learning", "control", "lab"),
    ("report", "export", "estimators"),
    ("results",),
    ("pipeline", "forecast"),
    ("streaming",),
    ("studies", "batch", "population", "capture"),
    ("terminal",),
    ("design", "paper"),
    ("__init__",),
    ("studio",),
    ("cli",),
    ("__main__",),
)
# One floor in the plan, but listed apart above so that neither may import the other.
STRANGERS = {("recording", "beam")}
ROOMS: dict[str, tuple[tuple[str, ...], ...]] = {
    "beam": (
        ("grid", "loads"),
        ("modal", "profiles"),
        ("statics",),
        ("clamped_ends", "motion"),
        ("model",),
    ),
    "recording": (
        ("signals", "tables"),
        ("dropped_samples", "toml"),
        ("force",),
        ("bags",),
        ("video", "stated", "beam_frame"),
        ("camera", "clock", "kept_frames"),
        ("tags", "tracks", "calibration", "tool"),
        ("gravity", "implausible_axes", "folder", "preview"),
        ("pairing", "photos", "template"),
        ("observe",),
    ),
    "learning": (
        ("outcome", "allowances", "modulus", "known_shape", "pose_equilibria"),
        ("model",),
        ("frequencies",),
        ("validation", "start", "inference", "swing"),
        ("learned_mass", "criticism", "paper", "attribution", "stiffness_band"),
        ("posterior",),
        ("criticism_messages", "tradeoffs", "live", "design", "endings"),
        ("verdict", "replay", "sensing"),
        ("explained",),
    ),
    "control": (
        ("goals",),
        ("reach", "shape"),
        ("path", "loop"),
    ),
    "lab": (
        ("materials", "pushes", "sensors", "random_beams", "extensible"),
        ("designs", "tag_errors", "effects"),
        ("design_file", "expected", "virtual", "fabrication"),
        ("direct_observation", "filming", "random_effects"),
        ("film_request", "marker_folder"),
        ("random_bench",),
    ),
    "streaming": (
        ("history", "reading"),
        ("review",),
        ("reviewer", "following", "state"),
        ("live",),
        ("played",),
    ),
    "capture": (
        ("clocks", "film_writer", "folder", "next_push"),
        ("sources", "state"),
        ("devices", "played", "pump", "guidance", "logs", "stages"),
        ("specs", "follower"),
        ("session",),
    ),
    "report": (
        ("findings", "kinds"),
        ("wording",),
        ("overview", "confidence", "modulus", "allowance_words"),
        ("figures", "verdict"),
        ("page",),
    ),
}


FACE = 99  # the floor of a layer's own `__init__`, which shows names out of all its rooms


def levels_of(floors: tuple[tuple[str, ...], ...]) -> dict[str, int]:
    return {name: level for level, names in enumerate(floors) for name in names}


LEVEL = levels_of(LAYERS)
ROOM_LEVEL = {layer: levels_of(floors) for layer, floors in ROOMS.items()}


def imported_modules(path: Path) -> list[tuple[int, str]]:
    """Line and dotted name of everything of onebend that the file imports, lazily too."""
    modules: list[tuple[int, str]] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: imports are absolute here"
            names = [f"{node.module}.{alias.name}" for alias in node.names]  # a module, or a name in one
        else:
            continue
        modules += [(node.lineno, name) for name in names if name.split(".")[0] == "onebend"]
    return modules


def breaches(package: Path) -> list[str]:
    """Every import that goes up or sideways between layers, or between the rooms of one, as `file:line: a -> b`."""
    wrong: list[str] = []
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package).with_suffix("").parts
        here, room = parts[0], parts[1] if len(parts) > 1 else None
        if here not in LEVEL:
            wrong.append(f"{path}: '{here}' stands on no floor; add it to LAYERS")
            continue
        if here in ROOMS and room not in (None, "__init__") and room not in ROOM_LEVEL[here]:
            wrong.append(f"{path}: '{here}.{room}' stands on no floor; add it to ROOMS")
            continue
        for line, module in imported_modules(path):
            names = module.split(".")[1:]
            there = names[0] if names else "__init__"
            if there != here:
                known = there in LEVEL
                if not known or LEVEL[there] >= LEVEL[here] or (here, there) in STRANGERS:
                    wrong.append(f"{path}:{line}: {here} -> {there}")
            elif here in ROOMS and room is not None and len(names) > 1 and names[1] != room:
                rooms = ROOM_LEVEL[here]
                if names[1] not in rooms or rooms[names[1]] >= rooms.get(room, FACE):
                    wrong.append(f"{path}:{line}: {here}.{room} -> {here}.{names[1]}")
    return wrong


def circles(package: Path) -> list[str]:
    """Modules that import themselves by way of others."""
    paths = {".".join(("onebend", *p.relative_to(package).with_suffix("").parts)): p for p in package.rglob("*.py")}
    needs = {}
    for name, path in paths.items():
        imported = {module for _, module in imported_modules(path)}
        needs[name] = (imported | {module.rpartition(".")[0] for module in imported}) & set(paths)
    while free := [name for name, needed in needs.items() if not needed & set(needs)]:
        for name in free:
            del needs[name]
    return sorted(needs)


def test_layers_and_their_rooms_import_downwards_only() -> None:
    assert breaches(PACKAGE) == []


def test_no_module_imports_itself_by_way_of_others() -> None:
    assert circles(PACKAGE) == []


@pytest.mark.parametrize(
    ("member", "line"),
    [
        ("beam", "from onebend.recording.force import cleaning"),
        ("beam", "import onebend"),
        ("recording", "from onebend.beam.statics import newton"),
        ("learning", "from onebend.control.reach import reach"),
        ("learning", "from onebend import pipeline"),
        ("report", "def lazy():\n    from onebend.cli import main"),
        ("beam/statics", "from onebend.beam.model import Beam"),
        ("beam/motion", "from onebend.beam import clamped_ends"),
        ("recording/clock", "import onebend.recording.camera"),
        ("learning/model", "from onebend.learning.optimizer import find_maximum"),
        ("learning/live", "from onebend.learning.design import plan"),
        ("control/reach", "def lazy():\n    from onebend.control.loop import controller"),
        ("lab/fabrication", "from onebend.lab.filming import film"),
        ("learning/cellar", "import math"),
    ],
)
def test_planted_breach_is_found(tmp_path: Path, member: str, line: str) -> None:
    (tmp_path / member).mkdir(parents=True)
    (tmp_path / member / "planted.py").write_text(line + "\n", encoding="utf-8")
    assert len(breaches(tmp_path)) == 1


def test_planted_circle_is_found(tmp_path: Path) -> None:
    (tmp_path / "beam" / "statics").mkdir(parents=True)
    (tmp_path / "beam" / "statics" / "one.py").write_text("from onebend.beam.statics.other import x\n")
    (tmp_path / "beam" / "statics" / "other.py").write_text("from onebend.beam.statics import one\n")
    assert circles(tmp_path) == ["onebend.beam.statics.one", "onebend.beam.statics.other"]
