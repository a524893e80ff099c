"""Why what the live learner says of k(s) is not to be relied on at the moment; none as a rule."""

from __future__ import annotations

import numpy as np

from onebend.learning.inference.misfit import MISS
from onebend.learning.live.key_frames import KeyFrames
from onebend.learning.live.tag_noise import force_in, without_force
from onebend.records import Array, BoolArray

FAR_OFF = 5.0  # times the tags' noise: so much is hardly the tags' alone
FAILED = "the last solution failed: k(s) is what was known before"
TOO_SOFT = "the estimate has no equilibrium under a force that the beam withstood"
_ROUGH = 1.7  # times the tags' noise: from there on what is left of the tags is more than that
_CLEAR_MISS = 3.0  # times the noise that a tag's own covariance says: less is no miss, however little it moves


def misfit(keys: KeyFrames, marker: float) -> float:
    """Root mean square of what the point where frames are linearised leaves of them, over what the tags' covariances
    say and with any force; 0 where it is no more than noise of size `marker`.
    """
    loaded = ~keys.rest[: keys.used]
    residual = (keys.root[: keys.used] @ keys.residual[: keys.used][..., None]).reshape(keys.used, -1)[loaded]
    r = without_force(residual, keys.rows_a[: keys.used][loaded])
    size = float(np.sqrt(np.vdot(r, r) / max(np.count_nonzero(r) - 2.0 * len(r), 1.0)))
    return size if size > _ROUGH * marker else 0.0


def key_frame_doubts(keys: KeyFrames, marker: float, coarse: float, missed: str) -> tuple[str, ...]:
    """What the key frames contradict; empty as a rule.

    `marker`: noise of the tags over what their covariances say; `coarse`: the misfit where it is more; `missed`: what
    `missed_tag` said last.
    """
    out = []
    if coarse > FAR_OFF * marker:
        out.append(f"the tags are off by {coarse / marker:.1f} times their noise: the estimate is still on its way")
    out += [missed] if missed else []
    lost = int(np.count_nonzero(keys.lost[: keys.used]))
    if lost:
        out.append(f"{lost} of {keys.used} key frames have no equilibrium at the estimate")
    return tuple(out)


def missed_tag(keys: KeyFrames) -> str:
    """The tag that is missed by most of its own motion whatever the force is, where that is more than the fit lets
    pass; else nothing."""
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
    """(m,) m: from end to end of where each tag was seen; infinite where it never was."""
    part = visible[..., None]
    across = np.max(xy, axis=0, initial=-np.inf, where=part) - np.min(xy, axis=0, initial=np.inf, where=part)
    return np.asarray(np.sqrt(across[:, 0] ** 2 + across[:, 1] ** 2))
