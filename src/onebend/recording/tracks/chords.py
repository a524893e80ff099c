"""Angles from the places of neighbouring markers, for trackers that give points only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.records import Array, Markers


def chord_angles(xy: Array, s: Array) -> Array:
    """(T, m) rad: the beam's angle at the markers, from places (T, m, 2) [m] and the clamp at the origin.

    The slope of a parabola in s through each marker and its two neighbours; at the tip the angle of the last chord is
    extrapolated. Good to a few hundredths of a radian: enough for clocks and rests, not for learning. NaN where a
    marker or a neighbour is missing.
    """
    order = np.argsort(s, kind="stable")
    places = np.concatenate([[0.0], s[order]])
    points = np.concatenate([np.zeros((len(xy), 1, 2)), xy[:, order]], axis=1)
    span = np.maximum(np.diff(places), 1e-9)
    chord = np.diff(points, axis=1)
    turn = np.arctan2(chord[..., 1], chord[..., 0])
    filled = np.where(np.isfinite(turn), turn, 0.0)
    turn = np.where(np.isfinite(turn), np.unwrap(filled, axis=1), np.nan)
    angle = np.empty_like(turn)
    share = span[:-1] / (span[:-1] + span[1:])
    angle[:, :-1] = turn[:, :-1] + share * (turn[:, 1:] - turn[:, :-1])
    before = turn[:, -2] if turn.shape[1] > 1 else np.zeros(len(turn))
    middle = 0.5 * (span[-1] + span[-2]) if len(span) > 1 else 0.5 * span[-1]
    angle[:, -1] = turn[:, -1] + 0.5 * span[-1] * (turn[:, -1] - before) / middle
    unordered = np.empty_like(angle)
    unordered[:, order] = angle
    return unordered


def with_angles(markers: Markers) -> Markers:
    """`markers` with an angle wherever the places give one; measured angles stay."""
    if np.isfinite(markers.angle[np.isfinite(markers.xy).all(axis=-1)]).all():
        return markers
    rough = chord_angles(markers.xy, markers.s)
    known = np.isfinite(markers.angle).any(axis=0)  # a marker either has angles or has none
    return replace(markers, angle=np.where(known, markers.angle, _continuous(rough)))


def _continuous(angle: Array) -> Array:
    """Columns without jumps by whole turns; NaN is stepped over."""
    continuous = angle.copy()
    for column in continuous.T:
        known = np.isfinite(column)
        column[known] = np.unwrap(column[known])
    return continuous
