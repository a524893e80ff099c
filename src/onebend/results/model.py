"""`model.json`: the learned beam, with all that is needed to simulate it, and where it comes from."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.stiffness import Profile
from onebend.beam.uncertain import UncertainStiffness
from onebend.errors import LearningError, MechanicsError, ResultsError
from onebend.learning.outcome import Learned
from onebend.learning.workbench import Bench

FORMAT = "onebend-model"
VERSION = 1
FILE_NAME = "model.json"
KEYS = {"format", "version", "written_by", "beam", "origin", "uncertain", "bench"}


@dataclass(frozen=True)
class Origin:
    """How a model came about. Informative: nothing is computed from it."""

    recording: str
    method: str
    family: str
    n: int  # curvature modes
    m: int  # stiffness functions
    marker_s: tuple[float, ...]  # places of the tags
    push_s: float | None  # furthest place pushed; what lies beyond was not loaded
    training_rms_m: tuple[float | None, ...]  # per tag


@dataclass(frozen=True)
class StoredModel:
    """What `model.json` holds."""

    beam: Beam
    origin: Origin | None
    uncertain: UncertainStiffness | None = None  # k(s) with its band; None after a regression
    bench: Bench | None = None  # what the recordings were made with, where the band is known


def origin_of(learned: Learned) -> Origin:
    """The provenance written beside a learned beam."""
    trial, training = learned.trials[learned.chosen], learned.training
    pushed = training.push_s[np.isfinite(training.push_s)]
    return Origin(
        recording=training.name,
        method=learned.method,
        family=learned.family,
        n=trial.n,
        m=trial.m,
        marker_s=tuple(float(s) for s in training.marker_s),
        push_s=float(pushed.max()) if pushed.size else None,
        training_rms_m=tuple(float(r) if np.isfinite(r) else None for r in training.rms),
    )


def save_model(
    path: Path,
    beam: Beam,
    *,
    written_by: str,
    origin: Origin | None = None,
    uncertain: UncertainStiffness | None = None,
    bench: Bench | None = None,
) -> None:
    """Write `beam` to `path`, so that `load_model` gives back an equal one."""
    data = {"format": FORMAT, "version": VERSION, "written_by": written_by, "beam": beam.as_dict()}
    if origin is not None:
        data["origin"] = asdict(origin)
    if uncertain is not None:
        data["uncertain"] = uncertain.as_dict()
    if bench is not None:
        data["bench"] = bench.as_dict()
    try:
        path.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    except ValueError as error:
        raise ResultsError(f"{path}: the beam holds a number that is not finite, so it was not written") from error


def load_model(path: Path | str) -> Beam:
    """The beam in `path`, a `model.json` or the results folder that holds one.

    Raises `ResultsError` where there is no such file, or it is damaged, of another version, or describes no beam.
    """
    return read_model(path).beam


def read_model(path: Path | str) -> StoredModel:
    """As `load_model`, with the model's origin."""
    file = Path(path)
    if file.is_dir():
        file = file / FILE_NAME
    data = _json_object(file)
    _check_kind(file, data)
    unknown = sorted(set(data) - KEYS)
    if unknown:
        raise ResultsError(f"{file}: key '{unknown[0]}' is not known. {_ADVICE}")
    return StoredModel(
        beam=_beam(file, data.get("beam")),
        origin=_origin(file, data.get("origin")),
        uncertain=_uncertain(file, data.get("uncertain")),
        bench=_bench(file, data.get("bench")),
    )


_ADVICE = "The file is damaged or was edited; restore it, or learn the beam again with `onebend learn`"


def _json_object(file: Path) -> dict[str, Any]:
    try:
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise ResultsError(
            f"{file}: no such file. Give a {FILE_NAME} or a folder that `onebend learn` wrote"
        ) from error
    except UnicodeDecodeError as error:
        raise ResultsError(f"{file}: not a text file. Give a {FILE_NAME} that `onebend learn` wrote") from error
    except OSError as error:
        raise ResultsError(f"{file}: cannot be read ({error.strerror})") from error
    try:
        data = json.loads(text)
    except json.JSONDecodeError as error:
        raise ResultsError(f"{file}, line {error.lineno}: not valid JSON ({error.msg}). {_ADVICE}") from error
    except RecursionError as error:
        raise ResultsError(f"{file}: nested too deeply to be a model. {_ADVICE}") from error
    if not isinstance(data, dict):
        raise ResultsError(f"{file}: holds a JSON {type(data).__name__}, not an object. {_ADVICE}")
    return data


def _check_kind(file: Path, data: dict[str, Any]) -> None:
    if data.get("format") != FORMAT:
        raise ResultsError(f"{file}: not a onebend model (key 'format' is {data.get('format')!r}, not {FORMAT!r})")
    if data.get("version") != VERSION:
        raise ResultsError(
            f"{file}: model version {data.get('version')!r}, but this onebend reads version {VERSION}. "
            "Use the onebend that wrote it, or learn the beam again with this one"
        )


def _origin(file: Path, data: Any) -> Origin | None:
    if data is None:
        return None
    if not isinstance(data, dict) or set(data) != {field.name for field in fields(Origin)}:
        raise ResultsError(f"{file}: key 'origin' is not as onebend writes it. {_ADVICE}")
    values: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in data.items()}
    return Origin(**values)


def _uncertain(file: Path, data: Any) -> UncertainStiffness | None:
    if data is None:
        return None
    try:
        return UncertainStiffness.from_dict(data)
    except (MechanicsError, KeyError, TypeError, ValueError) as error:
        raise ResultsError(f"{file}: key 'uncertain' is not as onebend writes it ({error}). {_ADVICE}") from error


def _bench(file: Path, data: Any) -> Bench | None:
    if data is None:
        return None
    try:
        return Bench.from_dict(data)
    except LearningError as error:
        raise ResultsError(f"{file}: key 'bench' {error}. {_ADVICE}") from error


def _beam(file: Path, data: Any) -> Beam:
    if not isinstance(data, dict):
        raise ResultsError(f"{file}: key 'beam' must be an object. {_ADVICE}")
    try:
        beam = Beam.from_dict(data)
        for name in ("stiffness", "rest_curvature", "mass_per_length"):
            _check_profile(f"{file}, beam.{name}", getattr(beam, name))
        if not np.isfinite([beam.length, beam.clamp_angle]).all():
            raise ResultsError(f"{file}: the beam's length or clamp angle is not finite. {_ADVICE}")
    except (MechanicsError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise ResultsError(f"{file}: describes no beam ({error}). {_ADVICE}") from error
    return beam


def _check_profile(where: str, profile: Profile) -> None:
    values = np.asarray(profile(np.linspace(0.0, 1.0, 201)))
    if values.shape != (201,) or not np.isfinite(values).all():
        raise ResultsError(f"{where}: has no finite value everywhere along the beam. {_ADVICE}")
