"""`model.json`: the learned beam, the band of its k(s), and its origin."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.model import Beam
from onebend.beam.section import ModulusBand, modulus_band, one_modulus, section_as_dict, section_from_dict
from onebend.beam.setup import SetUp
from onebend.beam.stiffness import Profile, UncertainStiffness
from onebend.errors import MechanicsError, OnebendError, ResultsError
from onebend.export.sample import RodSample, in_setup, rod_sample
from onebend.files.publish import OWN_CHECKSUM, SUMMARY, is_listed_otherwise, is_unchanged, with_checksum
from onebend.learning.outcome import Comparison, Learned, modulus_along
from onebend.record_data import record_from
from onebend.records import Array, StatedSection
from onebend.text_files import quoted, read_json

if TYPE_CHECKING:
    from onebend.learning.instruments import Instruments
    from onebend.learning.posterior import Posterior
    from onebend.learning.swing import Damping


Part = TypeVar("Part")


@dataclass(frozen=True)
class Origin:
    """For information only."""

    recording: str  # joined by " + "
    method: str
    family: str
    n: int | None  # curvature modes, if used
    m: int  # stiffness functions
    marker_s: tuple[float, ...]
    push_s: float | None  # farthest; beyond was not loaded
    training_rms_m: tuple[float | None, ...]


def origin_of(learned: Learned | None, posterior: Posterior | None, trainings: Sequence[Comparison]) -> Origin:
    """Of the fit, else of the regression."""
    from onebend.learning.frames import marker_rms  # here: reading a model loads no fit

    pushed = np.concatenate([comparison.push_s[np.isfinite(comparison.push_s)] for comparison in trainings])
    rms = marker_rms(np.concatenate([comparison.measured - comparison.predicted for comparison in trainings]))
    if posterior is not None:
        made: tuple[str, str, int | None, int] = ("fit", "log-spline", None, posterior.layout.spline.count)
    else:
        assert learned is not None
        trial = learned.trials[learned.chosen]
        made = (learned.method, learned.family, trial.n, trial.m)
    return Origin(
        " + ".join(comparison.name for comparison in trainings),
        *made,
        marker_s=tuple(float(s) for s in trainings[0].marker_s),
        push_s=float(pushed.max()) if pushed.size else None,
        training_rms_m=tuple(float(r) if np.isfinite(r) else None for r in rms),
    )


FORMAT = "onebend-model"
VERSION = 10
# versions: 1 had no `uncertain`, 2 no `damping`, 3 no checksum, 4 no `section`, 5 no `offset`, 6 no `shared_mean` and
# `discrepancy` in `bench`, 7 no `setup`, 8 one whose force error went with the tags'
# displacement: it is not read, and predictions are those of k(s) alone, 9 no `tag_ids` in `setup`
READABLE = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10)
_OF_PLACES = 9  # the first version whose set-up's force error goes with the place of the push
_OLD_SETUP = (
    "has a set-up of an older version, which is not read: answers are those of k(s) alone. Learn the beam again to "
    "have it"
)
FILE_NAME = "model.json"
WIDEST = 1e3  # sd of log k
KEYS = {
    "format",
    "version",
    "written_by",
    "beam",
    "origin",
    "uncertain",
    "bench",
    "setup",
    "damping",
    "section",
    OWN_CHECKSUM,
}


@dataclass(frozen=True)
class StoredModel:
    """Content of `model.json`."""

    beam: Beam
    origin: Origin | None
    uncertain: UncertainStiffness | None = None  # if learned with a band
    bench: Instruments | None = None  # instruments, if there is a band
    setup: SetUp | None = None  # in which it was learned, if a force log shows a push
    damping: Damping | None = None  # from a free swing
    section: StatedSection | None = None  # if stated
    changed: str = ""  # how the file was changed; its k(s) is then in doubt
    swapped: str = ""  # how it differs from the folder's summary
    left_out: str = ""  # what is not read of a file of an older version

    def bending(
        self,
        setup: SetUp,
        push_s: float,
        points: ArrayLike,
        *,
        tags: ArrayLike = -1,
        gravity: tuple[float, float] = (0.0, 0.0),
    ) -> tuple[StoredModel, SetUp]:
        """With the ideal beam that goes where this one goes in the `setup` (`SetUp.ideal`), above all at `points` or
        `tags`, if it is pushed at `push_s`; and the set-up with that push. Raises `ResultsError` without a band."""
        if self.uncertain is None:
            raise ResultsError("a model without a band on k(s) has no set-up to be bent in")
        now = setup.renewed(push_s=push_s, length=self.beam.length)
        beam, known = now.ideal(self.beam, self.uncertain, gravity=gravity, points=np.atleast_1d(points), tags=tags)
        return replace(self, beam=beam, uncertain=known), now


def save_model(
    path: Path,
    beam: Beam,
    *,
    written_by: str,
    origin: Origin | None = None,
    uncertain: UncertainStiffness | None = None,
    bench: Instruments | None = None,
    setup: SetUp | None = None,
) -> None:
    stored = StoredModel(beam, origin, uncertain, bench, setup)
    try:
        path.write_text(model_text(stored, written_by=written_by), encoding="utf-8")
    except ResultsError as error:
        raise ResultsError(f"{path}: {error}") from error


def model_text(stored: StoredModel, *, written_by: str) -> str:
    """Content of a `model.json`. Raises `ResultsError` for numbers that are not finite."""
    data: dict[str, Any] = {"format": FORMAT, "version": VERSION, "written_by": written_by}
    data["beam"] = stored.beam.as_dict()
    if stored.origin is not None:
        data["origin"] = asdict(stored.origin)
    for name in ("uncertain", "bench", "setup", "damping"):
        part = getattr(stored, name)
        if part is not None:
            data[name] = part.as_dict()
    if stored.section is not None:
        data["section"] = section_as_dict(stored.section)
    try:
        return json.dumps(with_checksum(data), indent=2, allow_nan=False) + "\n"
    except ValueError as error:
        raise ResultsError("the beam holds a number that is not finite, so it was not written") from error


def load_model(path: Path | str) -> Beam:
    """The beam in a `model.json` or results folder. Warns if the file was changed. Raises `ResultsError` if it is
    missing, damaged, of another version, or no beam."""
    return _read_and_warn(path).beam


def load_uncertain(path: Path | str) -> UncertainStiffness:
    """k(s) with its band, as `load_model`. A changed file gives a warning and a doubt. Raises `ResultsError` also
    without a band."""
    stored = _read_and_warn(path)
    if stored.uncertain is None:
        raise ResultsError(
            f"{path}: this model has no band: it was learned by the regression alone, or by an earlier onebend. "
            "Learn it again with `onebend learn`"
        )
    return stored.uncertain


def load_setup(path: Path | str) -> SetUp | None:
    """The set-up in which the beam was learned; None without band or force log. Warns and raises as `load_model`."""
    return _read_and_warn(path).setup


def load_modulus(path: Path | str, s: Array, level: float = 0.95) -> ModulusBand | None:
    """E(s) [Pa] at places s (S,), as `load_uncertain`; None without a stated section."""
    stored = _read_and_warn(path)
    section = stored.section
    if section is None:
        return None
    return modulus_band(stored.uncertain or stored.beam.stiffness, stored.beam.length, section, s, level)


def model_file(path: Path | str) -> Path:
    """The `model.json` that `path` is or contains."""
    file = Path(path)
    return file / FILE_NAME if file.is_dir() else file


def _read_and_warn(path: Path | str) -> StoredModel:
    stored = read_model(path)
    for words in filter(None, (stored.changed, stored.swapped, stored.left_out)):
        warnings.warn(f"{model_file(path)}: {words}", UserWarning, stacklevel=3)
    return stored


def read_model(path: Path | str) -> StoredModel:
    """As `load_model`, with all content."""
    file = model_file(path)
    data = _json_object(file)
    _check_kind(file, data)
    unknown = sorted(set(data) - KEYS)
    if unknown:
        raise ResultsError(f"{file}: key {quoted(unknown[0])} is not known. {_ADVICE}")
    beam = _beam(file, data.get("beam"))
    uncertain, changed = _uncertain(file, data.get("uncertain"), beam), _changed(data)
    if uncertain is not None and changed:
        uncertain = replace(uncertain, doubts=(*uncertain.doubts, f"{file.name} {changed}"))
    return StoredModel(
        beam=beam,
        origin=_part(file, data, "origin", partial(record_from, Origin)),
        uncertain=uncertain,
        bench=_part(file, data, "bench", _bench),
        setup=_part(file, data, "setup", partial(_setup, uncertain)) if data["version"] >= _OF_PLACES else None,
        damping=_part(file, data, "damping", _damping),
        section=_part(file, data, "section", section_from_dict),
        changed=changed,
        swapped=_swapped(file),
        left_out=_OLD_SETUP if data["version"] < _OF_PLACES and data.get("setup") else "",
    )


def _changed(data: dict[str, Any]) -> str:
    if (data["version"] < 4 and OWN_CHECKSUM not in data) or is_unchanged(data):
        return ""
    return "was changed after onebend wrote it, so what it says of k(s) is not what was learned"


def _swapped(file: Path) -> str:
    if not is_listed_otherwise(file):
        return ""
    return f"is not the file that the run of this folder wrote ({SUMMARY} lists another checksum)"


_VERSIONS = f"{', '.join(map(str, READABLE[:-1]))} and {READABLE[-1]}"
_ADVICE = "The file is damaged or was edited; restore it, or learn the beam again with `onebend learn`"


def _json_object(file: Path) -> dict[str, Any]:
    if not file.exists():
        raise ResultsError(f"{file}: no such file. Give a {FILE_NAME} or a folder that `onebend learn` wrote")
    data = read_json(file, ResultsError, _ADVICE)
    if not isinstance(data, dict):
        raise ResultsError(f"{file}: holds a JSON {type(data).__name__}, not an object. {_ADVICE}")
    return data


def _check_kind(file: Path, data: dict[str, Any]) -> None:
    if data.get("format") != FORMAT:
        raise ResultsError(
            f"{file}: not a onebend model (key 'format' is {quoted(data.get('format'))}, not {FORMAT!r})"
        )
    if data.get("version") not in READABLE:
        raise ResultsError(
            f"{file}: model version {quoted(data.get('version'))}, but this onebend reads versions {_VERSIONS}. "
            "Use the onebend that wrote it, or learn the beam again with this one"
        )


def _part(file: Path, data: dict[str, Any], name: str, read: Callable[[Any], Part]) -> Part | None:
    """What `read` makes of a key that may be missing."""
    try:
        return None if data.get(name) is None else read(data[name])
    except (OnebendError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise ResultsError(f"{file}: key {name!r} is not as onebend writes it ({error}). {_ADVICE}") from error


def _bench(data: Any) -> Instruments:
    from onebend.learning.instruments import Instruments  # here, and below: reading a model loads no fit

    return Instruments.from_dict(data)


def _setup(uncertain: UncertainStiffness | None, data: Any) -> SetUp:
    found = SetUp.from_dict(data)
    if uncertain is None or found.slope.shape[1] != len(uncertain.mean):
        raise ValueError("it does not fit the band of k(s)")
    return found


def _damping(data: Any) -> Damping:
    from onebend.learning.swing import Damping

    return Damping.from_dict(data)


def _beam(file: Path, data: Any) -> Beam:
    if not isinstance(data, dict):
        raise ResultsError(f"{file}: key 'beam' must be an object. {_ADVICE}")
    try:
        beam = Beam.from_dict(data)
        for name in ("stiffness", "rest_curvature", "mass_per_length"):
            _check_profile(f"{file}, beam.{name}", getattr(beam, name))
        if not np.isfinite([beam.length, beam.clamp_angle]).all():
            raise ResultsError(f"{file}: the beam's length or clamp angle is not finite. {_ADVICE}")
    except (MechanicsError, TypeError, ValueError, AttributeError, RecursionError, OverflowError) as error:
        raise ResultsError(f"{file}: describes no beam ({error}). {_ADVICE}") from error
    return beam


def _uncertain(file: Path, data: Any, beam: Beam) -> UncertainStiffness | None:
    if data is None:
        return None
    s = np.linspace(0.0, 1.0, 21)
    try:
        uncertain = UncertainStiffness.from_dict(data)
        spread = np.linalg.eigvalsh(uncertain.covariance)
        sized = -1e-9 * spread[-1] <= spread[0] and spread[-1] < WIDEST**2
        if not sized or not np.allclose(uncertain.covariance, uncertain.covariance.T):
            raise MechanicsError("its covariance is none")
        fits = np.allclose(uncertain.band(s).k, beam.stiffness(s), rtol=1e-9)
    except (MechanicsError, KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise ResultsError(f"{file}: key 'uncertain' describes no stiffness ({error!r}). {_ADVICE}") from error
    if not fits:
        raise ResultsError(f"{file}: key 'uncertain' is not the band of the beam's stiffness. {_ADVICE}")
    return uncertain


def _check_profile(where: str, profile: Profile) -> None:
    values = np.asarray(profile(np.linspace(0.0, 1.0, 201)))
    if values.shape != (201,) or not np.isfinite(values).all():
        raise ResultsError(f"{where}: has no finite value everywhere along the beam. {_ADVICE}")


def model_summary(stored: StoredModel) -> dict[str, Any]:
    """`show --json`."""
    origin = None if stored.origin is None else asdict(stored.origin)
    damping = None if stored.damping is None else stored.damping.as_dict()
    stiffness = stiffness_summary(stored.beam, stored.uncertain, stored.section)
    return {"beam": stored.beam.as_dict(), "origin": origin, "stiffness": stiffness, "damping": damping}


def stiffness_summary(
    beam: Beam, uncertain: UncertainStiffness | None, section: StatedSection | None = None
) -> dict[str, Any]:
    """k at eleven places, with band and Young's modulus if known."""
    s = np.linspace(0.0, 1.0, 11)
    found: dict[str, Any] = {"s": s.round(3), "k_N_m": beam.stiffness(s)}
    if uncertain is not None:
        band = uncertain.band(s)
        found |= {"k_lo_N_m": band.low, "k_hi_N_m": band.high, "identified": band.identified}
        found |= {"doubts": uncertain.doubts}
    modulus = modulus_along(beam, uncertain, section, s)
    if modulus is not None and section is not None:
        edges = {} if uncertain is None else {"E_lo_Pa": modulus.low, "E_hi_Pa": modulus.high}
        found |= {"E_Pa": modulus.modulus, **edges, "section": section_as_dict(section)}
    one = one_modulus(uncertain or beam.stiffness, beam.length, section)
    if one is not None:
        found |= dict(zip(("E_mean_Pa", "E_mean_lo_Pa", "E_mean_hi_Pa"), one, strict=True))
    return found


def sample_of_model(
    stored: StoredModel,
    *,
    mass: float | None = None,
    damping_time: float | None = None,
    sites: tuple[float, ...] = (),
    told: tuple[tuple[str, str], ...] = (),
) -> RodSample:
    """The most probable beam of a model, all that the model knows of it included. Arguments as for `rod_sample`."""
    damping_sd = 0.0
    if damping_time is None and stored.damping is not None:
        damping_time, damping_sd = stored.damping.loss_time, stored.damping.loss_time_sd / stored.damping.loss_time
    rod = rod_sample(
        stored.beam,
        mass=mass,
        damping_time=damping_time,
        sites=sites,
        section=stored.section,
        uncertain=stored.uncertain,
    )
    rod = replace(rod, damping_sd=damping_sd)
    if stored.setup is not None and stored.uncertain is not None:
        rod = in_setup(replace(rod, setup=stored.setup), stored.setup.mean)
    made = max(stored.bench.pushes, key=lambda push: push.largest, default=None) if stored.bench else None
    if made is None:
        return replace(rod, told=told)
    force = (made.largest * math.cos(made.direction), made.largest * math.sin(made.direction))
    return replace(rod, told=told, push=(force, made.at_s))
