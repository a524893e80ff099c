"""Where the body ends in a film: the edge of its top face beyond the tip.

The other edges tell what is across the body, and nothing of where along it a point lies. The end is the one place of a
bare body that is seen along it: it tells where the tip is in the frame of the recording. It is the same place of the
body in all pictures, while what lies behind it passes by.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from onebend.recording import flanks
from onebend.recording.signals import MAD_TO_SD, nan_median, runs
from onebend.records import Array

PICTURES = 24  # at most, spread evenly, in which the end is looked for
NEAR, FAR, APART = 0.02, 0.08, 2e-3  # of the length, and m: so far from where `length_m` puts the end it is looked for
ROWS: Array = np.array([-0.75, -0.6, -0.45, -0.3, 0.3, 0.45, 0.6, 0.75])  # of half the width: a dot is in the middle
OWN = 10.0  # px of the body's own colour, at which a row begins
LAST = 0.07  # of the length: part of a curve that tells the body's direction at its end; that of its last point swings
AGREE = 1.5  # px: so far may the end be from its usual place in one row, and in one picture
LEAST_SHARE = 0.4  # of the rows of a picture, and of the pictures, that must show it


def last_point(curve: flanks.Curve) -> flanks.Curve:
    """The end of a curve, with its direction there."""
    before = curve.xy[round((1.0 - LAST) * (len(curve.xy) - 1))]
    return flanks.Curve(curve.xy[-1:], np.arctan2(*(curve.xy[-1:] - before).T[::-1]))


def body_end(sights: Sequence[flanks.Sight], ends: Sequence[flanks.Curve], length: float, width: float) -> Array:
    """(N,) m by which a body of this `length` and `width` [m] ends beyond the last points of its curves, in each of N
    pictures; NaN where that is not seen, in all of them where it has no lasting place. It is looked for near these
    points, and if it is not there, farther off behind them."""
    near = _end_within(NEAR * length + APART, sights, ends, width)
    if np.isfinite(near).any():
        return near
    far = _end_within(FAR * length + APART, sights, ends, width)
    return np.where(far > NEAR * length + APART, far, np.nan)


def _end_within(far: float, sights: Sequence[flanks.Sight], ends: Sequence[flanks.Curve], width: float) -> Array:
    every, sample = _along(sights, ends, far, width)
    out, inside_it = np.full(len(sights), np.nan), np.isfinite(every).all(axis=(1, 2, 3))
    if inside_it.any():
        out[inside_it] = lasting_end(every[inside_it]) * sample[inside_it]
    return out


def lasting_end(colour: NDArray[np.float32]) -> Array:
    """(N,) samples from the middle of rows of colours (N, R, J, 3), which begin with `OWN` px of the body's own, to
    where they leave it in each picture; NaN as of `body_end`."""
    own = round(OWN / flanks.STEP)
    before = colour[:, :, :own]
    body = np.median(before, axis=(1, 2))[:, None] * np.ones((1, len(ROWS), 1))  # (N, R, 3)
    shade = MAD_TO_SD * np.median(np.abs(before.mean(axis=2) - body), axis=(0, 1))
    pixel_sd = np.maximum(flanks.pixel_noise(before, axis=2), 1.0)
    look = flanks.Look(np.maximum(shade, 1.0), pixel_sd)
    at = np.arange(flanks.SAMPLES_ASIDE, colour.shape[2] - flanks.SAMPLES_ASIDE)
    inside, outside = flanks.sides_of(colour, at)
    step = flanks.unlike(outside, body, look) - flanks.unlike(inside, body, look)
    size = np.median(maximum_filter1d(step, 2 * round(AGREE / flanks.STEP) + 1, axis=2), axis=(0, 1))
    clear, nothing = runs(size >= flanks.LEAST), np.full(len(colour), np.nan)
    if not len(clear):
        return nothing
    first, last = clear[-1]  # behind a band that is painted on the body, its colour begins again
    usual = float(np.mean(at[first:last][size[first:last] == np.max(size[first:last])]))
    found = flanks.edges_near(colour, np.full(colour.shape[:2], usual), np.full(1, flanks.LEAST), pixel_sd)
    most = AGREE / flanks.STEP
    found = np.where(np.abs(found - nan_median(found.ravel())) <= most, found, np.nan)
    end = np.where(np.isfinite(found).mean(axis=1) >= LEAST_SHARE, nan_median(found, axis=1), np.nan)
    shown = np.isfinite(end).mean() >= LEAST_SHARE
    return end - own - (colour.shape[2] - own) // 2 if shown else nothing


def _along(
    sights: Sequence[flanks.Sight], ends: Sequence[flanks.Curve], far: float, width: float
) -> tuple[NDArray[np.float32], Array]:
    """(N, R, J, 3) colours of rows along the body's end, from its own colour on to `far` [m] beyond, the curve's end in
    the middle behind that colour, NaN beside the picture; and (N,) m from one to the next."""
    scale = np.empty(len(sights))
    ahead = np.empty((len(sights), 2))
    for i, (sight, curve) in enumerate(zip(sights, ends, strict=True)):
        turned = flanks.Curve(curve.xy, curve.angle - 0.5 * np.pi)  # its normal runs along the body
        ahead[i], scale[i] = (one[0] for one in sight.outward(turned))
    reach = round(far * float(np.median(scale)) / flanks.STEP) + flanks.SAMPLES_ASIDE
    out = flanks.STEP * np.arange(-reach - round(OWN / flanks.STEP), reach + 1)
    colour = []
    for sight, curve, along in zip(sights, ends, ahead, strict=True):
        rows = curve.xy + 0.5 * width * ROWS[:, None] * curve.normal
        places = sight.pixels(rows)[:, None] + out[:, None] * along
        colour.append(sight.planes.at(places))
    return np.stack(colour), flanks.STEP / scale
