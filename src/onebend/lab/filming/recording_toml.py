"""`recording.toml` from the entries that reading it gives: the inverse of `recording.folder.read_recording`."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from onebend.recording.bags.recorded_topics import BAG_KEYS
from onebend.recording.toml.description import FORMAT
from onebend.recording.toml.entries import Recording
from onebend.recording.toml.schema import Key, keys_of


def recording_toml(recording: Recording) -> str:
    """The text of a `recording.toml` that says what `recording` holds; what is not known is left out."""
    parts = [f"format = {FORMAT}\nname = {json.dumps(recording.name)}\n"]
    tags = recording.tags
    parts += [table("[beam]", recording.beam), table("[tags]", tags)]
    parts += [table("[[tags.on_base]]", tag) for tag in tags.on_base]
    parts += [table("[[tags.on_beam]]", tag) for tag in tags.on_beam]
    named = {name: getattr(recording, name) for name in ("camera", "video", "markers", "force", "push", "gravity")}
    parts += [table(f"[{name}]", entry) for name, entry in named.items() if entry is not None]
    return "\n".join(parts)


def table(header: str, entry: Any) -> str:
    """One table with every key whose value is known; those of bags only where a bag is meant."""
    lines = [header]
    bagged = bool(getattr(entry, "topic", ""))
    for name, (key, _) in keys_of(type(entry)).items():
        if key.name in BAG_KEYS and not bagged:
            continue
        value = getattr(entry, name)
        unknown = value is None or value == "" or (isinstance(value, float) and not math.isfinite(value))
        if not unknown:
            lines.append(f"{key.name} = {as_toml(value, key)}")
    return "\n".join(lines) + "\n"


def as_toml(value: Any, key: Key) -> str:
    """A value in the file's units."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Path):
        return json.dumps(value.name)
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, tuple):
        return "[" + ", ".join(as_toml(item, key) for item in value) + "]"
    if isinstance(value, float):
        written = math.degrees(value) if key.name.endswith("_deg") else value
        short = f"{written:.10g}"
        return short if math.isclose(float(short), written, rel_tol=1e-15) else repr(written)
    return str(value)
