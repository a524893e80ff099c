"""What a person should know of a marker-space fit: how near it comes to the tags, and what is odd about it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.learning.attribution import Attribution
from onebend.learning.criticism_messages import criticism_remarks
from onebend.learning.inference.misfit import recording_rms
from onebend.learning.model.parameters import Priors, clamp_sd
from onebend.learning.posterior import Posterior
from onebend.records import Array, Observations, Remark

_TESTED_AS = {"place": "push place", "direction": "force direction"}
_FAR = 3.0  # prior sds: a nuisance beyond says that the prior, or the recording, is wrong
_ANOTHER = 1.0  # change of log k, to first order: beyond, its size says nothing
_MOST_NAMED = 4  # allowances in one sentence
_LOUD = 3.0  # times the noise of the tags' own covariances: more is remarked on


def fitted_rms(posterior: Posterior) -> tuple[Array, ...]:
    """(m,) m of each recording: distance of the tags from the fit, its nuisances (slow force error, ...) applied.

    NaN for a tag that was never seen. Unlike the RMS of a `Comparison`, errors of the force log are taken off here.
    """
    return tuple(
        recording_rms(recording, fitted) for recording, fitted in zip(posterior.recordings, posterior.slow, strict=True)
    )


def grade_words(posterior: Posterior) -> str:
    """The verdict on k(s) in a sentence: what it allows for, and what that costs."""
    if posterior.grade == "not to be trusted":
        return f"k(s) is not to be trusted: {'; '.join(posterior.doubts)}"
    matter = [a for a in posterior.attributions if a.matters]
    if not matter:
        return "k(s) holds: the beam and the bench are as the model has them"
    return "k(s) holds with allowances: " + "; ".join(_share_words(a) for a in matter[:_MOST_NAMED])


def _share_words(share: Attribution) -> str:
    """One allowance and its share."""
    parts = []
    if share.sure:
        off = f"{100.0 * np.expm1(share.shift):.2g} % off" if share.shift < _ANOTHER else "another altogether"
        parts.append(f"without it k(s) would be {off}")
    parts.append(f"it widens the band by a factor of {share.widening:.2f}")
    return f"{share.name} ({', '.join(parts)})"


def fit_remarks(posterior: Posterior) -> tuple[Remark, ...]:
    """Warnings and notes on the fit itself. Where it misses hopelessly, only that: no value that came out counts."""
    wrong = [
        Remark("warning", f"{_whose(posterior, one.name)}{one.words}: k(s) and its band are not to be relied on")
        for one in posterior.misses
    ]
    if any(one.hopeless for one in posterior.misses):
        return (*wrong, *_search(posterior))
    told = criticism_remarks(posterior)
    allows = any(recording.allowances for recording in posterior.recordings)
    grade = [Remark("note", grade_words(posterior))] if allows and not posterior.doubts else []
    return (*wrong, *grade, *_search(posterior), *told, *_clamp(posterior), *_nuisances(posterior), *_noise(posterior))


def _search(posterior: Posterior) -> list[Remark]:
    if posterior.optimum.converged:
        return []
    text = f"the fit did not converge ({posterior.optimum.stopped}): k(s) and its band are not to be relied on"
    return [Remark("warning", text)]


def _clamp(posterior: Posterior) -> list[Remark]:
    usual = max(_usual_clamp(film.observations) for film in posterior.recordings)
    sd = max((float(b.prior_sd[0]) for b in posterior.layout.blocks if b.name == "clamp"), default=usual)
    if sd <= 1.001 * usual:
        return []
    text = (
        f"the clamp's direction was left free to {np.rad2deg(sd):.2g} deg (sd; usual: {np.rad2deg(usual):.2g} deg). A "
        "turned clamp looks like a softer beam near it, so this can cost what the data say of k there; see the band"
    )
    return [Remark("warning", text)]


def _usual_clamp(one: Observations) -> float:
    """rad, the clamp's sd where nobody says more of it; of poses, what their recording says."""
    return clamp_sd(one if one.static else replace(one, stated=replace(one.stated, clamp_sd=np.nan)), Priors())


def _nuisances(posterior: Posterior) -> list[Remark]:
    """Those far from their priors that the tests of the model, which know what data must do to them, let pass."""
    told = {(f.score.suspect.name, f.score.suspect.tag) for f in posterior.criticism.striking}
    ids = posterior.recordings[0].observations.tag_id.tolist()
    sized = {
        a.name for recording in posterior.recordings for a in recording.allowances if a.enters == "poses" and a.sized
    }
    out = []
    for block in posterior.layout.blocks:
        if block.start < 0 or block.name in {"stiffness", "force"} | sized:
            continue
        away = np.abs(posterior.mean[block.where]) / block.prior_sd
        for i in np.flatnonzero(away > _FAR):
            tag = ids[i] if block.name in ("along", "across", "turn") else -1
            if (_TESTED_AS.get(block.name, block.name), tag) not in told:
                text = (
                    f"{block.labels[i]} came out {away[i]:.1f} times as far off as recording.toml and the priors allow "
                    "(one sd): something may not be as it is written there"
                )
                out.append(Remark("note", text))
    return out


def _noise(posterior: Posterior) -> list[Remark]:
    out = []
    for seen, noise in zip(posterior.recordings, posterior.optimum.hyperparameters.noise, strict=True):
        if noise.marker > _LOUD:
            whose = _whose(posterior, seen.observations.source.name)
            text = (
                f"{whose}the tags' misfit, which lasts from frame to frame, counts as "
                f"{noise.marker:.1f} times the noise that the pictures explain; the band is that much wider"
            )
            if seen.observations.static:
                said = "as sd_m says" if seen.observations.sd_known else "as was guessed of the readings"
                text = f"{whose}the points miss {noise.marker:.1f} times as far {said}; the band is that much wider"
            out.append(Remark("note", text))
    return out


def _whose(posterior: Posterior, name: str) -> str:
    """The recording that a remark is on, where there are several."""
    return f"{name}: " if len(posterior.recordings) > 1 else ""
