"""Whether the tags are turned on the beam as recording.toml says; a wrong turn_deg is off by a quarter turn or more."""

from __future__ import annotations

import numpy as np

from onebend.errors import ObservationError
from onebend.recording.toml.entries import Recording
from onebend.records import Array, Markers

OFF = np.deg2rad(60.0)  # between a tag and the beam there: bending does not make that in most frames
NEAREST = 0.05  # of the beam: the chord of tags nearer to each other gives no direction


def check_turns(markers: Markers, recording: Recording) -> None:
    """An error where a tag points across the beam, or backwards, in most frames.

    The beam's direction at a tag is that of the chords to its neighbours; the base tag stands at the clamp.
    """
    order = np.argsort(markers.s, kind="stable")
    order = order[markers.s[order] > NEAREST]
    ids = [recording.tags.on_base[0].id, *markers.tag_id[order].tolist()]
    places = np.concatenate([np.zeros((len(markers.time), 1, 2)), markers.xy[:, order]], axis=1)
    s = np.concatenate([[0.0], markers.s[order]])
    complete = np.isfinite(places).all(axis=(1, 2))
    if not complete.any() or len(s) < 2 or np.any(np.diff(s) < NEAREST):
        return
    tag_angle = np.concatenate([np.zeros((len(markers.time), 1)), markers.angle[:, order]], axis=1)[complete]
    off = np.angle(np.exp(1j * (tag_angle - directions(places[complete]))))
    wrong = np.median(np.cos(off), axis=0) < np.cos(OFF)
    if not wrong.any():
        return
    written = {tag.id: tag.turn for tag in (*recording.tags.on_base, *recording.tags.on_beam)}
    wrong_tags = []
    for i in np.flatnonzero(wrong):
        quarter = 90 * round(float(np.rad2deg(np.angle(np.mean(np.exp(1j * off[:, i]))))) / 90)
        fits = 180 - (180 - round(float(np.rad2deg(written[ids[i]]))) - quarter) % 360
        wrong_tags.append(f"tag {ids[i]} (turn_deg = {np.rad2deg(written[ids[i]]):.4g}; {fits} would fit)")
    raise ObservationError(
        f"{recording.name}: seen from the line of the tags these are turned otherwise than recording.toml says: "
        f"{', '.join(wrong_tags)}. Correct turn_deg in [tags]: a tag's right-hand side against the beam's direction.",
        about="tag places",
    )


def directions(places: Array) -> Array:
    """(T, n) rad, of the line through places (T, n, 2): from the chords beside each, straight on at the ends."""
    chord = np.diff(places, axis=1)
    angle = np.unwrap(np.arctan2(chord[..., 1], chord[..., 0]), axis=1)
    bend = np.diff(angle, axis=1) if angle.shape[1] > 1 else np.zeros((len(angle), 1))
    first, last = angle[:, :1] - 0.5 * bend[:, :1], angle[:, -1:] + 0.5 * bend[:, -1:]
    return np.concatenate([first, 0.5 * (angle[:, 1:] + angle[:, :-1]), last], axis=1)
