"""What the tests of the model say, in plain words: what does not fit, by how much, why, and what to do."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from onebend.learning.criticism.alternatives import Suspect
from onebend.learning.criticism.criticism import ALARM_WRITTEN, Criticism, Finding
from onebend.learning.posterior import Posterior
from onebend.records import Array, Remark

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


def _weight(value: Array, _: Posterior) -> _Words:
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
    "weight": _weight,
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
