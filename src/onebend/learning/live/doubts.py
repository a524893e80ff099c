"""Reasons not to rely on the live learner's k(s) at the moment; usually there are none."""

from __future__ import annotations

import numpy as np

from onebend.learning.inference.misfit import MISS
from onebend.learning.live.key_frames import KeyFrames
from onebend.learning.live.tag_noise import force_in, without_force
from onebend.records import Array, BoolArray

FAR_OFF = 5.0  # times the tags' noise: a larger misfit is not of the tags alone
FAILED = "the last solution failed: k(s) is what was known before"
TOO_SOFT = "the estimate has no equilibrium under a force that the beam withstood"
_ROUGH = 1.7  # times the tags' noise: smaller misfits pass as noise
_CLEAR_MISS = 3.0  # times the noise that a tag's covariance states: a smaller residual is no miss


def misfit(keys: KeyFrames, marker: float) -> float:
    """Root mean square of the tags' whitened residuals at the linearisation point, less what a force error in each
    frame explains; 0 where it is no more than noise of size `marker`.
    """
    loaded = ~keys.rest[: keys.used]
    residual = (keys.root[: keys.used] @ keys.residual[: keys.used][..., None]).reshape(keys.used, -1)[loaded]
    r = without_force(residual, keys.rows_a[: keys.used][loaded])
    size = float(np.sqrt(np.vdot(r, r) / max(np.count_nonzero(r) - 2.0 * len(r), 1.0)))
    return size if size > _ROUGH * marker else 0.0


def key_frame_doubts(keys: KeyFrames, marker: float, size: float, missed: str) -> tuple[str, ...]:
    """The doubts that the key frames raise.

    `marker`: noise of the tags over their covariances; `size`: of the `misfit`; `missed`: what `missed_tag` returned.
    """
    out = []
    if size > FAR_OFF * marker:
        out.append(
            f"the tags are {size / marker:.2g} times their noise from the estimate, which still moves: go on pushing"
        )
    out += [missed] if missed else []
    lost = int(np.count_nonzero(keys.lost[: keys.used]))
    if lost:
        out.append(f"{lost} of {keys.used} key frames have no equilibrium at the estimate")
    return tuple(out)


def missed_tag(keys: KeyFrames) -> str:
    """A sentence on the tag whose residual is the largest share of its motion, whatever the force error; empty where
    the fit would accept that share (`MISS`)."""
    used = keys.used
    visible = keys.information[:used, :, 0, 0] > 0.0
    pushed = visible & ~keys.rest[:used, None]
    if not np.any(pushed):
        return ""
    frames = pushed * keys.frames[:used, None]
    counts = np.maximum(frames.sum(axis=0), 1.0)  # (m,) frames
    force = force_in((keys.root[:used] @ keys.residual[:used][..., None]).reshape(used, -1), keys.rows_a[:used])
    residual = keys.residual[:used, :, :2] - (keys.a[:used, :, :2] @ force[:, None, :, None])[..., 0]
    rms = np.sqrt((frames[..., None] * residual**2).sum(axis=(0, 2)) / counts)
    of_xy = (pushed * (keys.information[:used, :, 0, 0] + keys.information[:used, :, 1, 1])).sum(axis=0)
    noise = 2.0 / np.sqrt(np.maximum(of_xy / counts, 1e-300))  # m, of one frame, x and y alike
    motion = _motion(keys.measured[:used, :, :2], visible)
    share = np.where(np.any(pushed, axis=0) & (rms > _CLEAR_MISS * noise), rms / np.maximum(motion, 1e-300), 0.0)
    worst = int(np.argmax(share))
    if share[worst] <= MISS:
        return ""
    return (
        f"the estimate misses tag {worst + 1} by {1000.0 * rms[worst]:.3g} mm RMS where it moves by "
        f"{1000.0 * motion[worst]:.3g} mm"
    )


def _motion(xy: Array, visible: BoolArray) -> Array:
    """(m,) m: diagonal of the rectangle in which each tag was seen; infinite where it never was."""
    part = visible[..., None]
    across = np.max(xy, axis=0, initial=-np.inf, where=part) - np.min(xy, axis=0, initial=np.inf, where=part)
    return np.asarray(np.sqrt(across[:, 0] ** 2 + across[:, 1] ** 2))
