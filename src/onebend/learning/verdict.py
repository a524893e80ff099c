"""What a person should know of a marker-space fit: how near it comes to the tags, and what is odd about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from onebend.learning.allowances import BETWEEN
from onebend.learning.criticism import ALARM_WRITTEN, Criticism, Finding, Suspect
from onebend.learning.fit_data import FitData
from onebend.learning.frames import zeroed_coordinates
from onebend.learning.optimizer import recording_rms
from onebend.learning.outcome import Comparison, Explained
from onebend.learning.parameters import Layout, Priors, clamp_sd
from onebend.learning.posterior import Posterior
from onebend.learning.prediction import Prediction
from onebend.learning.push_place import FAR, LIKELIER, moved_off
from onebend.learning.static_poses import pose_names
from onebend.progress import one_blas_thread
from onebend.records import Array, Observations, Remark

# What the tests of the model say, in plain words: what does not fit, by how much, why, and what to do.

_SLIP = 1e-3  # m, by which the push may act beside where it is said to
_OUT = 1.2  # s: a push farther out than that is no place
_OUT_OF_SCALE = 0.5  # of the force: two axes whose scales differ by more than a factor of three
_LINEAR = 1.0  # change of log k: what the tests say of it is to first order, and says nothing beyond
_Words = tuple[str, str]  # what it would be, and what to do


def criticism_remarks(posterior: Posterior) -> tuple[Remark, ...]:
    """A warning where the model does not hold; a note on what stands out but hardly moves k(s)."""
    critic = posterior.criticism
    small = [f for f in critic.striking if f not in critic.alarms]
    odd = [
        Remark(
            "note",
            f"{supposed_words(f, posterior)}: more than chance explains, but too little to matter: k(s) would change "
            "by "
            "less than half of its sd",
        )
        for f in small
    ]
    return tuple(odd) if critic.trusted else (_verdict(posterior), *odd)


def _verdict(posterior: Posterior) -> Remark:
    critic = posterior.criticism
    rest = any(a.name == "discrepancy" for recording in posterior.recordings for a in recording.allowances)
    more = "there is more in the recording than the fit allows for"
    parts = [f"{more} by a cause; its discrepancy allows for the rest" if rest else more]
    if critic.symptoms:
        parts.append("What does not fit: " + "; ".join(symptom_words(f, posterior) for f in critic.symptoms))
    if critic.causes:
        first, *others = (cause_words(f, posterior) for f in critic.causes)
        parts.append(f"Likeliest cause: {first[0]}. {first[1]}")
        if others:
            parts.append("About as likely: " + "; ".join(what for what, _ in others))
        parts.append(_effect(critic))
    else:
        parts.append("No single cause that is known of explains it. Look at the residuals in the report, tag by tag")
    return Remark("warning", ". ".join(parts), about=about_causes(critic))


def about_causes(critic: Criticism) -> str:
    """What the warning is about, for docs/troubleshooting.md: the likeliest cause that is known of."""
    known = [one.score.suspect for one in critic.causes[:1] if one.score.suspect.kind != "trend"]
    return known[0].name if known else "unexplained"


def _effect(critic: Criticism) -> str:
    best = critic.causes[0]
    if best.shift > _LINEAR:
        return "With the likeliest one taken into account k(s) would be another altogether"
    change = 100.0 * float(np.expm1(best.shift))
    return (
        f"With the likeliest one taken into account k(s) would change by up to {change:.2g} %; a band "
        f"{critic.widening:.2g} times as wide would hold that k(s), if this is the only cause"
    )


def symptom_words(finding: Finding, posterior: Posterior) -> str:
    """Which coordinate of which tag, and how much."""
    suspect = finding.score.suspect
    whose = f"{suspect.recording}: " if len(posterior.recordings) > 1 else ""
    return f"{whose}{_residuals(suspect)} ({_millimetres(finding.score.size)} RMS)"


def _residuals(suspect: Suspect) -> str:
    return f"residuals of tag {suspect.tag} in {suspect.name} that follow the load"


def cause_words(finding: Finding, posterior: Posterior) -> _Words:
    """What it would be, and what to do about it."""
    suspect, value = finding.score.suspect, finding.score.value
    whose = f"{suspect.recording}: " if suspect.recording and len(posterior.recordings) > 1 else ""
    if suspect.kind == "mechanics":
        what, do = _MECHANICS[suspect.name](value, posterior)
    elif suspect.kind == "prior":
        what, do = _PRIORS[suspect.name](value, suspect.tag)
    elif suspect.kind == "change":
        what, do = _CHANGES[suspect.name](finding.score.size, suspect.tag)
    else:
        what, do = symptom_words(finding, posterior), "Look at the residuals of this tag in the report"
    if all(one.observations.static for one in posterior.recordings):
        do = _OF_POSES.get(suspect.name, do)
    if suspect.name == "scale" and not _filmed(posterior):
        do = "Check the unit and the scale of the tags' places"
    return whose + what, do


def unseen_words(posterior: Posterior) -> str:
    """What a wrong place of the push would do, which hardly shows in the tags; empty where nothing was pushed."""
    for one in posterior.criticism.findings:
        value = one.score.value
        if one.score.suspect.name == "push place" and np.all(np.isfinite(value)) and np.all(value != 0.0):
            share = _SLIP / posterior.recordings[0].observations.length / abs(float(value[0]))
            seen = -ALARM_WRITTEN * float(one.score.sd[0])  # about 3 sd
            change = 100.0 * float(np.expm1(share * one.shift))
            said = _millimetres(max(f.observations.stated.place_sd for f in posterior.recordings))
            return (
                f"A push {_millimetres(_SLIP)} from where at_s says it acts would change k(s) by up to {change:.2g} % "
                f"({share * one.sds:.1f} sd). The band allows for {said} (at_sd_m); more would be noticed only if it "
                f"were off by more than about {_millimetres(seen * posterior.recordings[0].observations.length)}"
            )
    return ""


def supposed_words(finding: Finding, posterior: Posterior) -> str:
    """What was tested."""
    if finding.score.suspect.kind == "trend":
        suspect = finding.score.suspect
        whose = f"{suspect.recording}: " if len(posterior.recordings) > 1 else ""
        return f"{whose}{_residuals(suspect)}"
    if not finding.score.able:
        return f"{finding.score.suspect.name}: nothing in the data tells"
    return cause_words(finding, posterior)[0]


def _stretch(value: Array, _: Posterior) -> _Words:
    do = "Push less far, or more across the beam; a beam that stretches is beyond this model"
    if value[0] <= 0.0:
        return "the beam gets shorter where it is pulled", "Check the force's sign, the tags' places and the length"
    return f"the beam stretches (E A about {_two_digits(1.0 / value[0])} N)", do


def _shear(value: Array, _: Posterior) -> _Words:
    size = f" (G A about {_two_digits(1.0 / value[0])} N)" if value[0] > 0.0 else ""
    return (
        f"the beam shears{size}",
        "Learn from a thinner beam: one as thick as that, or as soft across, is beyond this model",
    )


def _length(value: Array, posterior: Posterior) -> _Words:
    said = posterior.recordings[0].observations.length
    side = "longer" if value[0] > 0.0 else "shorter"
    words = f"the beam is about {_millimetres(said * abs(value[0]))} {side} than the {1000 * said:.4g} mm written down"
    squares = ", and the size of the tags' squares" if _filmed(posterior) else ""
    return words, f"Measure length_m from the clamp's edge to the tip, and the tags' s{squares}"


def _place(value: Array, posterior: Posterior) -> _Words:
    said = float(np.median(posterior.recordings[0].push_s))
    where = f"at about s = {said + value[0]:.3g}, " if 0.0 < said + value[0] < _OUT else ""
    words = f"the push acts {where}not at {said:.3g}"
    return words, "Check [push] at_s; if it is not known, state at_sd_m, and the fit finds it within that"


def _beside(value: Array, _: Posterior) -> _Words:
    words = f"the push acts {_millimetres(abs(value[0]))} beside the beam's axis"
    return words, "Push on the axis, with a tool that does not hold the beam"


def _direction(value: Array, _: Posterior) -> _Words:
    if abs(value[0]) > 1.0:  # rad, beyond what a straight line tells
        return "the force's direction is wrong", "Check columns and rotation_deg in [force]"
    words = f"the force's direction is off by {_degrees(value[0])}"
    return words, f"Check columns in [force], and whether rotation_deg is {np.rad2deg(value[0]):+.2g} from what it says"


def _axes(value: Array, _: Posterior) -> _Words:
    do = "Calibrate each axis of the force sensor with a weight"
    if abs(value[0]) > _OUT_OF_SCALE:
        return "the scales of the force's two axes differ", do
    more, less = ("y", "x") if value[0] > 0.0 else ("x", "y")
    off = 100.0 * ((1.0 + abs(value[0])) / (1.0 - abs(value[0])) - 1.0)
    return f"the force along {more} is measured {off:.0f} % too large against that along {less}", do


def _weight_words(value: Array, _: Posterior) -> _Words:
    words = f"a weight of about {float(np.linalg.norm(value)):.2g} N bends the beam"
    return words, "Check [gravity] and mass_kg, and that nothing hangs from the beam"


def _viscous(_: Array, __: Posterior) -> _Words:
    return (
        "the shape lags behind the force",
        "Push more slowly; a beam that flows is beyond this model",
    )


def _pliant(_: Array, __: Posterior) -> _Words:
    return "the clamp gives way under the load", "Hold the beam more firmly"


def _rest(_: Array, __: Posterior) -> _Words:
    return "the beam is not straight at rest", 'Write rest = "unknown" in [beam]'


def _otherwise(_: Array, posterior: Posterior) -> _Words:
    known = posterior.layout.known
    of_section = known is not None and known.section is not None
    sizes = "Check the section's sizes and state section_sd_m; or state" if of_section else "State"
    words = "k(s) varies along the beam otherwise than stiffness_along says"
    return words, f"{sizes} modulus_varies, or leave stiffness_along out"


_MECHANICS: dict[str, Callable[[Array, Posterior], _Words]] = {
    "stretch": _stretch,
    "shear": _shear,
    "length": _length,
    "push place": _place,
    "push beside": _beside,
    "force direction": _direction,
    "axis scale": _axes,
    "weight": _weight_words,
    "viscous": _viscous,
    "clamp gives": _pliant,
    "rest shape": _rest,
    "stiffness along": _otherwise,
}
_PLACES = "Measure where it sits and correct its s, or state a wider placement_sd_m"
_PRIORS: dict[str, Callable[[Array, int], _Words]] = {
    "along": lambda v, tag: (
        f"tag {tag} sits {_millimetres(abs(v[0]))} along the beam from its written place",
        _PLACES,
    ),
    "across": lambda v, tag: (f"tag {tag} sits {_millimetres(abs(v[0]))} beside its written place", _PLACES),
    "turn": lambda v, tag: (f"tag {tag} is turned by {_degrees(v[0])}", _PLACES),
    "clamp": lambda v, _: (
        f"the clamp is turned by {_degrees(v[0])}",
        "Check the direction of the clamp, or state clamp_sd_deg",
    ),
    "origin": lambda v, _: (
        f"the clamp is {_millimetres(float(np.linalg.norm(v)))} from where it is taken to be",
        "Check where the beam leaves the clamp, length_m and the tags' s",
    ),
    "scale": lambda v, _: (
        f"measured lengths are off by {100 * v[0]:.2g} %",
        "Calibrate the camera; check size_m",
    ),
    "clock": lambda v, _: (f"the clocks are off by {1000 * abs(v[0]):.0f} ms", "Check start_s and the frame times"),
    "mass": lambda _, __: (
        "the beam's weight and the force do not agree: the mass, or how it is spread, is not as written, or the force",
        "Check mass_kg, [gravity], and that the log is in newtons (not kg or g)",
    ),
    "curvature": lambda _, __: ("the beam at rest is bent more than expected", "Check the tags' places and the rest"),
    "rest change": lambda _, __: (
        "the beam's shape at rest changed by more than rest_change_sd_deg says",
        "Look whether it took a set between the recordings",
    ),
}
_OF_POSES = {  # what to do where nothing was filmed, pushed or logged
    "stretch": "Hang less on, or more across the beam; a beam that stretches is beyond this model",
    "mass": "Check mass_kg, [gravity], and that weight_N is in newtons and the loads' mass_kg in kilograms",
    "origin": "Check that x_m and y_m are from where the beam leaves the clamp, length_m, and the points' s",
    "clamp": "Check clamp_deg and base_angle_deg, or state a wider clamp_sd_deg",
    "curvature": "Check the points of the bare beam, or state a wider rest_curvature_sd_deg",
}
_CHANGES: dict[str, Callable[[float, int], _Words]] = {
    "creep": lambda size, _: (
        f"the beam's own shape changed by {_millimetres(size)} on the way (it creeps, or yields)",
        "Push less far, or faster; let the beam rest between pushes",
    ),
    "slip": lambda size, _: (f"the clamp slipped (tags move by {_millimetres(size)})", "Hold the beam more firmly"),
    "loose": lambda size, tag: (f"tag {tag} moved on the beam by {_millimetres(size)}", "Glue it, and record anew"),
}


def _filmed(posterior: Posterior) -> bool:
    """Whether a camera saw any of it."""
    return any(one.observations.source.view is not None for one in posterior.recordings)


def _two_digits(value: float) -> str:
    return f"{float(f'{value:.2g}'):.9g}"  # 550, not 5.5e+02


def _millimetres(metres: float) -> str:
    return f"{_two_digits(1000.0 * metres)} mm"


def _degrees(radians: float) -> str:
    return f"{abs(float(np.rad2deg(radians))):.2g} deg"


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
    wrong += [*_elsewhere(posterior), *_weight_remarks(posterior)]
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


def _weight_remarks(posterior: Posterior) -> list[Remark]:
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


# A recording as the marker-space fit explains it: every nuisance applied, the force log's slow error taken off.

PLACES = np.linspace(0.0, 1.0, 121)  # of the centre line


@one_blas_thread
def explained(posterior: Posterior) -> tuple[Explained, ...]:
    """Every recording of a fit, in the frames that it used."""
    parts = zip(posterior.recordings, posterior.slow, fitted_rms(posterior), strict=True)
    return tuple(_one(posterior, recording, prediction, rms) for recording, prediction, rms in parts)


def _one(posterior: Posterior, recording: FitData, prediction: Prediction, rms: Array) -> Explained:
    observations, x, layout = recording.observations, posterior.mean, posterior.layout
    used = slice(0, int(np.sum(recording.frames)))  # beyond them stands the beam at rest
    scale, origin = 1.0 + layout.get(x, "scale", recording.number), layout.get(x, "origin", recording.number)
    comparison = Comparison(
        name=observations.source.name,
        frame=observations.frame[recording.frames],
        time=observations.time[recording.frames],
        tag_id=observations.tag_id,
        marker_s=observations.marker_s,
        measured=_points(recording, layout, x, recording.measured)[used],
        predicted=_points(recording, layout, x, prediction.pose)[used],
        force=prediction.force[used],
        push_s=recording.push_s[used],
        stable=prediction.solved.stable[used],
        rms=rms,
        sensor_rms=np.full(len(observations.tag_id), np.nan),
        likely_rms=np.full(len(observations.tag_id), np.nan),
        static=observations.static,
    )
    return Explained(comparison, scale * prediction.solved.xy(PLACES)[used] + origin, recording.force[used])


def _points(recording: FitData, layout: Layout, x: Array, poses: Array) -> Array:
    """(F, m, 2) m, poses (F, m, 3) counted from the clamp, and at their rulers."""
    points, zeros = poses[..., :2].copy(), layout.get(x, "zero", recording.number)
    for (i, c), zero in zip(zeroed_coordinates(recording.observations), zeros, strict=True):
        points[:, i, c] += zero
    if recording.rulers is not None:
        points[..., 0] = np.where(np.isfinite(points[..., 1]), recording.rulers, np.nan)
    return points
