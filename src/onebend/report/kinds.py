"""What kind a recording is, and the words that go with it: who hung weights does not read of a film or a force log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from onebend.records import Observations

Kind = Literal["film", "tracks", "photos", "poses", "frequencies"]


@dataclass(frozen=True)
class KindWords:
    """How one kind of recording is spoken of."""

    kind: Kind
    frames: str  # several instants of it
    under: str  # what the beam is simulated under without a fit's corrections
    inputs: str  # the heading over what was read
    gone_by: str  # what an hour of work is compared with; empty where nothing passed


WORDS: dict[Kind, KindWords] = {
    "film": KindWords("film", "frames", "under the force as logged", "Force and clock", "video"),
    "tracks": KindWords("tracks", "frames", "under the force as logged", "Force and clock", "recording"),
    "photos": KindWords("photos", "photos", "under the loads as written", "Loads and photos", ""),
    "poses": KindWords("poses", "poses", "under the loads as written", "Loads and points", ""),
    "frequencies": KindWords("frequencies", "frequencies", "as it swings", "Frequencies", ""),
}


def kind_of(observations: Observations) -> Kind:
    """Film, marker tracks, photos of the loaded beam, a table of static poses, or natural frequencies alone."""
    if observations.frequencies and observations.static and not np.any(observations.marker_s):
        return "frequencies"
    if observations.static:
        return "poses" if observations.source.view is None else "photos"
    return "tracks" if observations.source.view is None else "film"


def words_of(observations: Observations) -> KindWords:
    """How this recording is spoken of."""
    return WORDS[kind_of(observations)]


def is_forced(observations: Observations) -> bool:
    """Whether a known force bends it, and not its weight alone."""
    if not observations.static:
        return observations.source.clean_force is not None
    return observations.known_loads is not None or bool(np.any(observations.force != 0.0))


def only_static(recordings: Sequence[Observations]) -> bool:
    """Whether all of them are static poses or photos: nothing was logged over time."""
    return all(one.static for one in recordings)


def learned_from(observations: Observations) -> str:
    """What of it was used: "440 loaded frames of a film (600 in all)", "6 poses under known loads"."""
    swings = f"{len(observations.frequencies)} natural frequencies"
    if kind_of(observations) == "frequencies":
        return swings
    return _shown(observations) + (f", and {swings}" if observations.frequencies else "")


def only_frequencies(recordings: Sequence[Observations]) -> bool:
    """Whether nothing was seen of the beam but how fast it swings."""
    return all(kind_of(one) == "frequencies" for one in recordings)


def _shown(observations: Observations) -> str:
    count, used, kind = len(observations.time), int(observations.loaded.sum()), kind_of(observations)
    if observations.static:
        of = "photos of the beam" if kind == "photos" else "static poses"
        return f"{count} {of} under {'known loads' if is_forced(observations) else 'its own weight'}"
    of = "a film" if kind == "film" else "marker tracks"
    if not is_forced(observations):
        return f"{count} frames of {of}, under its own weight"
    return f"{used} loaded frames of {of} ({count} in all)"
