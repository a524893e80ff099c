"""What a person should know of a marker-space fit: how near it comes to the tags, and what is odd about it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.learning.allowances.mounting import BETWEEN
from onebend.learning.criticism.criticism import Finding
from onebend.learning.criticism.push_place import FAR, LIKELIER, moved_off
from onebend.learning.criticism_messages import criticism_remarks
from onebend.learning.inference.misfit import recording_rms
from onebend.learning.model.parameters import Priors, clamp_sd
from onebend.learning.pose_equilibria import pose_names
from onebend.learning.posterior import Posterior
from onebend.records import Array, Observations, Remark

_TESTED_AS = {"place": "push place", "direction": "force direction"}
_FAR = 3.0  # prior sds: a nuisance beyond says that the prior, or the recording, is wrong
_OF_THE_PUSH = ("push place", "push beside", "place", "force direction", "direction", "axis scale")
_G = 9.81  # m/s^2
_LIGHTEST = 500.0  # kg/m^3: foams apart, nothing that bends and springs back is lighter
_FAR_DOWN = 0.5  # of the length
_LOUD = 3.0  # times the noise of the tags' own covariances: more is remarked on


def fitted_rms(posterior: Posterior) -> tuple[Array, ...]:
    """(m,) m of each recording: distance of the tags from the fit, its nuisances (slow force error, ...) applied.

    NaN for a tag that was never seen. Unlike the RMS of a `Comparison`, errors of the force log are taken off here.
    """
    return tuple(
        recording_rms(recording, fitted) for recording, fitted in zip(posterior.recordings, posterior.slow, strict=True)
    )


def possible(posterior: Posterior) -> Posterior:
    """The posterior without the tests of what cannot be.

    Poses under known loads have no place of a push and no axes of a log; and nothing that hangs on a beam by mistake is
    much heavier than what bends it otherwise.
    """
    critic = posterior.criticism
    kept = tuple(one for one in critic.findings if _can_be(one, posterior))
    return replace(posterior, criticism=replace(critic, findings=kept))


def _can_be(finding: Finding, posterior: Posterior) -> bool:
    suspect = finding.score.suspect
    whose = [one.observations for one in posterior.recordings]
    whose = [one for one in whose if suspect.recording in ("", one.source.name)]
    if suspect.name in _OF_THE_PUSH:
        return any(not one.static and np.any(one.force != 0.0) for one in whose)
    if suspect.name == "weight":
        return float(np.linalg.norm(finding.score.value)) <= max(_heaviest(one) for one in whose)
    return True


def _heaviest(one: Observations) -> float:
    """N, the most that could hang on a beam by mistake: its own weight, or the largest force, and as much again."""
    force = float(np.nanmax(np.linalg.norm(one.force, axis=1), initial=0.0))
    if one.known_loads is not None:
        force = max(force, float(np.nanmax(np.linalg.norm(one.known_loads.force, axis=2), initial=0.0)))
    return 2.0 * max(force, _G * one.stated.mass if np.isfinite(one.stated.mass) else 0.0)


def fit_remarks(posterior: Posterior) -> tuple[Remark, ...]:
    """Warnings and notes on the fit itself. Where it misses hopelessly, only that: no value that came out counts."""
    wrong = [
        Remark(
            "warning",
            f"{_whose(posterior, one.name)}{one.words}: k(s) is NOT TO BE TRUSTED. {_first_check(posterior)}",
            about="miss",
        )
        for one in posterior.misses
    ]
    if any(one.hopeless for one in posterior.misses):
        return (*wrong, *_search(posterior))
    wrong += [*_elsewhere(posterior), *_weight(posterior)]
    tests = _tests(posterior)
    wrong += _left_out(posterior)
    odd = (*_clamp(posterior), *_nuisances(posterior), *_noise(posterior))
    return (*wrong, *_search(posterior), *tests, *_hanging(posterior), *odd)


def _elsewhere(posterior: Posterior) -> list[Remark]:
    """What the evidence says of the place of the push, where it speaks for another one, or does not tell."""
    found, off = posterior.place, moved_off(posterior.layout, posterior.mean)
    if off > FAR and not (found is not None and found.accused):
        text = (
            f"the fit takes the push {off:.2g} times as far from at_s as at_sd_m allows (one sd): k(s) is NOT TO BE "
            "TRUSTED. Measure the place, and correct at_s in [push]"
        )
        return [Remark("warning", text, about="push place")]
    if found is None or not (found.accused or found.open):
        return []
    low, high = (f"{place:.2g}" for place in found.range)
    where = f"at about s = {low}" if low == high else f"between s = {low} and {high}"
    if found.accused:
        text = (
            f"the push acts {where}, as tags and force say, not at {found.written:.3g}: k(s) is NOT TO BE TRUSTED. "
            "With the push there, a far simpler k(s) explains the recording. Measure the place, and correct at_s in "
            "[push]"
        )
        return [Remark("warning", text, about="push place")]
    if found.mistaken > LIKELIER:
        text = (
            f"the push acts {where} far more likely than at {found.written:.3g}, as tags and force say; k(s) goes by "
            "its way from there, and the band holds all of that. Measure the place, and correct at_s in [push]"
        )
        return [Remark("warning", text, about="push place")]
    text = (
        f"tags and force leave open where the push acts, {where}, and k(s) goes by its way from there: the band holds "
        "all of that. Let the film show the tool, push where there is a tag, or measure the place closely and say "
        "in [push] how closely"
    )
    return [Remark("note", text)]


def _weight(posterior: Posterior) -> list[Remark]:
    """A warning where the fit's weight is not the one that is written."""
    if not posterior.weight_doubts:
        return []
    text = (
        f"{' and '.join(posterior.weight_doubts)}: k(s) is NOT TO BE TRUSTED. Check base_angle_deg and direction_deg "
        "in [gravity], mass_kg, and that the log is in newtons (not kg or g)"
    )
    return [Remark("warning", text, about="mass")]


def _left_out(posterior: Posterior) -> list[Remark]:
    """The poses on which k(s) does not rest; why, the comparison with the recording says."""
    out = []
    for recording, left_out in zip(posterior.recordings, posterior.left_out, strict=True):
        names = pose_names(recording.observations, left_out)
        if names:
            said = f"pose {names[0]} was" if len(names) == 1 else f"poses {', '.join(names)} were"
            text = f"{_whose(posterior, recording.observations.source.name)}{said} left out of the fit: no stable "
            out.append(Remark("note", text + "equilibrium of the beam that fits the others is near the points there"))
    return out


def _tests(posterior: Posterior) -> tuple[Remark, ...]:
    """What the tests of the model say."""
    able = possible(posterior)
    told = criticism_remarks(able)
    if posterior.criticism.trusted or not able.criticism.trusted:
        return told
    text = (
        "there is more in the recording than the fit allows for, and nothing that is known of explains it. Look at the "
        "residuals in the report, tag by tag"
    )
    return (Remark("warning", text, about="unexplained"), *told)


def _search(posterior: Posterior) -> list[Remark]:
    if posterior.optimum.converged:
        return []
    text = f"the fit did not converge ({posterior.optimum.stopped}): k(s) is NOT TO BE TRUSTED"
    text += ". Push further, or learn from several pushes"
    return [Remark("warning", text, about="not converged")]


def _first_check(posterior: Posterior) -> str:
    """What is most often wrong where the fit misses the tags."""
    if all(one.observations.static for one in posterior.recordings):
        return "Check the loads and their unit, then the signs of x and y, and clamp_deg"
    if any(np.any(one.observations.force != 0.0) for one in posterior.recordings):
        return "Check the sign and the axes of [force], then the clocks"
    return "Check the tags' places and the direction of gravity"


def _hanging(posterior: Posterior) -> list[Remark]:
    """A warning where a beam of this k(s), section and weight would hang far out of the plane, as none that is filmed.

    A cantilever of mass m hangs down by `m g L^2 int (1 - s)^3 / (2 k) ds`, k being that of the other direction: larger
    by the square of the section's size across the plane over that in it.
    """
    one, s = posterior.recordings[0].observations, np.linspace(0.0, 1.0, 201)
    section, upright = one.stated.section, any(np.any(r.observations.gravity) for r in posterior.recordings)
    if section is None or section.shape != "rectangle" or one.static or upright:
        return []
    thick, deep = (np.interp(s, section.s, size) for size in (section.thickness, section.width))
    light = _LIGHTEST * one.length * float(np.trapezoid(thick * deep, s))
    mass = one.stated.mass if np.isfinite(one.stated.mass) else light
    bends = (1.0 - s) ** 3 / (2.0 * posterior.beam.stiffness(s)) * (thick / deep) ** 2
    sag = mass * _G * one.length**2 * float(np.trapezoid(bends, s))
    if sag < _FAR_DOWN * one.length:
        return []
    text = (
        f"with this k(s) the beam, of {1000.0 * mass:.2g} g or more, would hang down out of the plane by its weight "
        f"(by {1000.0 * sag:.2g} mm, to first order), unless it lies on something. Is the log in newtons (not kg)? "
        "Check width_m, thickness_m and mass_kg, too"
    )
    return [Remark("warning", text, about="force unit")]


def _clamp(posterior: Posterior) -> list[Remark]:
    usual = max(_usual_clamp(film.observations) for film in posterior.recordings)
    sd = max((float(b.prior_sd[0]) for b in posterior.layout.blocks if b.name == "clamp"), default=usual)
    if sd <= 1.001 * usual:
        return []
    text = (
        f"the clamp's direction was left free to {np.rad2deg(sd):.2g} deg (sd; usual: {np.rad2deg(usual):.2g} deg). A "
        "turned clamp looks like a softer beam near it, so the band is wider there. Measure the clamp's direction"
    )
    return [Remark("warning", text, about="free clamp")]


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
        if block.start < 0 or block.name in {"stiffness", "force", BETWEEN} | sized:
            continue
        away = np.abs(posterior.mean[block.where]) / block.prior_sd
        for i in np.flatnonzero(away > _FAR):
            tag = ids[i] if block.name in ("along", "across", "turn") else -1
            said = block.name == "place" and away[i] > FAR
            if not said and (_TESTED_AS.get(block.name, block.name), tag) not in told:
                text = (
                    f"{block.labels[i]} came out {away[i]:.1f} times as far off as recording.toml and the priors allow "
                    "(one sd): check what is written of it"
                )
                out.append(Remark("note", text))
    return out


def _noise(posterior: Posterior) -> list[Remark]:
    out = []
    for seen, noise in zip(posterior.recordings, posterior.optimum.hyperparameters.noise, strict=True):
        if noise.marker > _LOUD:
            whose = _whose(posterior, seen.observations.source.name)
            times = f"{float(f'{noise.marker:.2g}'):g} times"
            text = (
                f"{whose}the tags stay farther from the fit than their noise in the pictures explains, for many frames "
                f"in a row; for this the band is {times} as wide"
            )
            if seen.observations.static:
                said = "sd_m says" if seen.observations.sd_known else "was guessed of the readings"
                text = f"{whose}the points are {times} as far from the fit as {said}; the band is as much wider"
            out.append(Remark("note", text))
    return out


def _whose(posterior: Posterior, name: str) -> str:
    """The recording that a remark is on, where there are several."""
    return f"{name}: " if len(posterior.recordings) > 1 else ""
