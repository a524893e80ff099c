"""What the residuals of the key frames say: noise of the tags, robust weights, surprises and doubts."""

from __future__ import annotations

import numpy as np

from onebend.learning.optimizer import MISS
from onebend.live.key_frames import CheckedFrame, KeyFrames
from onebend.live.posterior import KeyFramePosterior
from onebend.records import Array, BoolArray
from onebend.report.sentences import say

# Noise of the tags, from the residuals of the key frames less what an error of each frame's force explains. Averages of
# frames show the error of averages, so errors that last count with their correlation time.

_BULK = 5.0  # sd: larger residuals are cut off there
_LEAST = 0.02  # over the tags' covariances: the smallest size; an outline's noise is at least as stated, as in the fit
_GUESS_COUNTS = 60.0  # the first value weighs as much as so many residuals
_NO_FORCE = 1e-9  # 1/N^2: added, so that a force that moves no tag comes out as zero


def tag_residuals(keys: KeyFrames, solution: KeyFramePosterior) -> Array:
    """(K, 3 m) whitened residuals of the key frames at the solution."""
    used = keys.used
    e = solution.e[len(solution.e) - used :]
    by_error = (keys.rows_a[:used] @ e[..., None])[..., 0]
    return np.asarray(keys.rows_z[:used] - keys.rows_j[:used] @ solution.x + by_error)


def counted(keys: KeyFrames, residual: Array) -> Array:
    """(K, 3 m) whitened residuals (K, 3 m), of an outline's points the one number that counts."""
    out = residual.reshape(len(residual), len(keys.traced), 3).copy()
    across = np.linalg.norm(out[:, keys.traced], axis=-1)
    out[:, keys.traced] = across[..., None] * np.array([1.0, 0.0, 0.0])
    return np.asarray(out.reshape(residual.shape))


def force_in(residual: Array, a: Array) -> Array:
    """(K, 2) N: the force error of each frame that fits its residuals (K, R) best; `a` (K, R, 2): derivatives of the
    residuals with it."""
    turned = a.swapaxes(1, 2)
    return np.asarray(np.linalg.solve(turned @ a + _NO_FORCE * np.eye(2), turned @ residual[..., None])[..., 0])


def without_force(residual: Array, a: Array) -> Array:
    """Residuals (K, R) less what a force error of each frame explains; `a` (K, R, 2) as in `force_in`."""
    return np.asarray(residual - (a @ force_in(residual, a)[..., None])[..., 0])


def robust_weights(keys: KeyFrames, residual: Array, sizes: Array, bulk: float) -> Array:
    """(K, m) robust weights of the tags: 1 where the residual is within `bulk` sd, beyond it falling with its square.

    In the bulk all tags have the same weight: the averages of two frames would mix them unevenly otherwise.
    """
    distance = np.sqrt(np.sum(residual.reshape(len(residual), -1, 3) ** 2, axis=-1)) / sizes
    visible = keys.information[: keys.used, :, 0, 0] > 0.0
    return np.asarray(visible * np.minimum(1.0, bulk / np.maximum(distance, 1e-300)) ** 2)


def tag_noise_size(keys: KeyFrames, residual: Array, spent: float, expected: float) -> float:
    """Size of the tags' noise over what their covariances say; without tags of the outline's.

    `spent`: effective number of parameters; `expected`: the size before the data.
    """
    loaded = ~keys.rest[: keys.used]
    r = counted(keys, without_force(residual[loaded], keys.rows_a[: keys.used][loaded]))
    r = r[:, np.repeat(~keys.traced | keys.traced.all(), 3)]
    numbers = float(np.count_nonzero(r)) - 2.0 * len(r)
    if numbers <= 0.0:
        return expected
    sizes = np.sort(np.abs(r[r != 0.0]))
    most = _BULK * float(sizes[len(sizes) // 2]) / 0.6745
    left_over = max(numbers - spent, 0.3 * numbers)
    squares = float(np.sum(np.minimum(sizes, most) ** 2)) + _GUESS_COUNTS * expected**2
    return max(float(np.sqrt(squares / (left_over + _GUESS_COUNTS))), 1.0 if keys.traced.all() else _LEAST)


def surprise(
    keys: KeyFrames,
    frame: CheckedFrame,
    solution: KeyFramePosterior,
    x: Array,
    sizes: Array,
    expected: tuple[Array, float],
) -> tuple[Array, Array]:
    """Innovation (m, 3) of the last key frame at parameters x, and its distance (m,) in sd.

    `sizes` (m,) of the markers' noise; `expected`: rows (slots,) of the frame's force error on the known ones, its
    variance.
    """
    i, tags, (rows, own) = keys.used - 1, len(frame.visible), expected
    j, a = keys.j[i].reshape(-1, len(x)), keys.a[i].reshape(-1, 2)
    innovation = keys.zeta[i] - keys.j[i] @ x + keys.a[i] @ keys.error[i]
    by_errors, p = (-a[:, None, :] * rows[None, :, None]).reshape(len(j), -1), solution.count
    spread = solution.spread(np.concatenate([j[:, :p], by_errors, j[:, p:]], axis=1)) + own * a @ a.T
    blocks = spread.reshape(tags, 3, tags, 3)[np.arange(tags), :, np.arange(tags)]
    inverse = np.linalg.pinv(blocks + sizes[:, None, None] ** 2 * frame.covariance, hermitian=True)
    return innovation, np.sqrt(np.maximum(np.einsum("mi,mij,mj->m", innovation, inverse, innovation), 0.0))


FAR_OFF = 5.0  # times the tags' noise: a larger misfit is not of the tags alone
_ROUGH = 1.7  # times the tags' noise: smaller misfits pass as noise
_CLEAR_MISS = 3.0  # times the noise that a tag's covariance states: a smaller residual is no miss


def misfit(keys: KeyFrames, sizes: Array) -> Array:
    """(m,) root mean square of the markers' whitened residuals at the linearisation point, less what a force error in
    each frame explains, in proportion to their noise of these `sizes` (m,); 0 where it is no more than that.
    """
    loaded = ~keys.rest[: keys.used]
    root, a = keys.root[: keys.used] / sizes[:, None, None], keys.rows_a[: keys.used] / np.repeat(sizes, 3)[:, None]
    residual = (root @ keys.residual[: keys.used][..., None]).reshape(keys.used, -1)[loaded]
    r = counted(keys, without_force(residual, a[loaded]))
    size = float(np.sqrt(np.vdot(r, r) / max(np.count_nonzero(r) - 2.0 * len(r), 1.0)))
    return size * sizes * (size > _ROUGH)


def key_frame_doubts(keys: KeyFrames, rough: float, missed: str) -> tuple[str, ...]:
    """The doubts that the key frames raise; `rough`: the `misfit` over the noise; `missed` as of `missed_tag`."""
    out = []
    if rough > FAR_OFF:
        out.append(say("live: far off", times=rough))
    out += [missed] if missed else []
    lost = int(np.count_nonzero(keys.lost[: keys.used]))
    if lost:
        out.append(say("live: no equilibrium", lost=lost, frames=keys.used))
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
    told, traced = keys.information[:used, :, :2, :2], keys.traced
    of_xy = np.maximum(np.trace(told, axis1=2, axis2=3), 1e-300)
    across = (told @ residual[..., None])[..., 0] / of_xy[..., None]  # of an outline's points what is measured
    residual = np.where(traced[:, None], across, residual)
    rms = np.sqrt((frames[..., None] * residual**2).sum(axis=(0, 2)) / counts)
    noise = np.where(traced, 1.0, 2.0) / np.sqrt(np.maximum((pushed * of_xy).sum(axis=0) / counts, 1e-300))  # m
    motion = _motion(keys.measured[:used, :, :2], visible)
    motion = np.where(traced, np.max(motion, initial=0.0, where=np.isfinite(motion)), motion)
    share = np.where(np.any(pushed, axis=0) & (rms > _CLEAR_MISS * noise), rms / np.maximum(motion, 1e-300), 0.0)
    worst = int(np.argmax(share))
    if share[worst] <= MISS:
        return ""
    what = "the outline" if traced[worst] else f"tag {worst + 1}"
    return say("live: tag missed", tag=what, rms=rms[worst], motion=motion[worst])


def _motion(xy: Array, visible: BoolArray) -> Array:
    """(m,) m: diagonal of the rectangle in which each tag was seen; infinite where it never was."""
    part = visible[..., None]
    across = np.max(xy, axis=0, initial=-np.inf, where=part) - np.min(xy, axis=0, initial=np.inf, where=part)
    return np.asarray(np.sqrt(across[:, 0] ** 2 + across[:, 1] ** 2))
