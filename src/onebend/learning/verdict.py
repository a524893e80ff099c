"""Findings about a fit as codes with numbers (sentences: `report.sentences`), and each recording as the fit explains
it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from onebend.learning import allowances, criticism, fit_data, frames, optimizer, parameters, push_place, static_poses
from onebend.learning.outcome import Comparison, Explained, Notice
from onebend.learning.posterior import Posterior
from onebend.learning.prediction import Prediction
from onebend.progress import one_blas_thread
from onebend.records import Array, Observations, read_before_fit

_SLIP = 1e-3  # m, an error of the push's place whose effect is told
_OUT = 1.2  # s: a push farther out than that is no place
_OUT_OF_SCALE = 0.5  # of the force: two axes whose scales differ by more than a factor of three
_LINEAR = 1.0  # change of log k: the tests are of first order and mean nothing beyond
_TESTED_AS = {"place": "push place", "direction": "force direction"}
_FAR = 3.0  # prior sds: beyond it the prior or the recording is wrong
_OF_THE_PUSH = ("push place", "push beside", "place", "force direction", "direction", "axis scale", "force curve")
_OF_A_TAG = ("along", "across", "turn")
_G = 9.81  # m/s^2
_LIGHTEST = 500.0  # kg/m^3: apart from foams, nothing elastic is lighter
_FAR_DOWN = 0.5  # of the length
_LOUD = 3.0  # times the noise of the tags' own covariances: a larger noise gets a note


def fit_notices(posterior: Posterior) -> tuple[Notice, ...]:
    """Warnings and notes on the fit. If it misses a recording hopelessly, on the misses alone: no value counts then."""
    misses = [_miss(posterior, one.name, one.tag, one.rms, one.motion) for one in posterior.misses]
    stopped = posterior.optimum.stopped
    search = () if posterior.optimum.converged else (Notice("not converged", {"why": stopped}),)
    if why := posterior.without_outline:
        search = (*search, Notice("outline left out", {"why": why}))
    if any(one.hopeless for one in posterior.misses):
        return (*misses, *search)
    doubts = posterior.weight_doubts
    weight = (Notice("weight contradicts", {"doubts": " and ".join(doubts)}),) if doubts else ()
    wrong = (*misses, *_push_elsewhere(posterior), *weight, *_left_out(posterior), *search)
    odd = (*_hanging(posterior), *_free_clamp(posterior), *_far_nuisances(posterior), *_loud(posterior))
    return (*wrong, *_test_notices(posterior), *odd)


def mass_notices(mass: parameters.LearnedMass | None) -> tuple[Notice, ...]:
    """A notice of the learned mass, and of how it is spread if that is stated."""
    if mass is None:
        return ()
    written = "written" if np.isfinite(mass.written) else "not written"
    learned = "learned" if mass.identified else "not learned"
    spread = "" if mass.along == "unknown" else ", spread"
    return (Notice(f"mass: {written}, {learned}{spread}", {**vars(mass), "spread": Notice(f"spread: {mass.along}")}),)


def criticism_notices(posterior: Posterior) -> tuple[Notice, ...]:
    """A warning if the model does not hold, and a note on each test that stands out but hardly moves k(s)."""
    critic = posterior.criticism
    small = [one for one in critic.striking if one not in critic.alarms]
    slight = tuple(Notice("slight", {"what": what_is_tested(one, posterior)}) for one in small)
    if critic.trusted:
        return slight
    rest = any(a.name == "discrepancy" for recording in posterior.recordings for a in recording.allowances)
    causes = tuple(cause(one, posterior) for one in critic.causes)
    shift = critic.causes[0].shift if causes else 0.0
    values = {
        "symptoms": tuple(cause(one, posterior) for one in critic.symptoms),
        "causes": causes,
        "change": float(np.expm1(shift)) if shift <= _LINEAR else np.inf,
        "widening": critic.widening,
    }
    return (Notice("more by a cause" if rest else "more", values), *slight)


def cause(finding: criticism.Finding, posterior: Posterior) -> Notice:
    """The code of the cause that a test is of, with its numbers."""
    suspect, data = finding.score.suspect, [one.observations for one in posterior.recordings]
    values: dict[str, Any] = {
        "tag": suspect.tag,
        "axis": suspect.name,
        "moved": finding.score.size,
        "static": all(one.static for one in data),
        "filmed": any(one.source.view is not None for one in data),
    }
    code = suspect.name
    if suspect.kind == "trend":
        code = "trend"
    elif suspect.kind != "change":
        value = float(finding.score.value[0])
        values |= {"value": value, "size": abs(value), "norm": float(np.linalg.norm(finding.score.value))}
    if suspect.kind == "mechanics":
        more, numbers = _variant(suspect.name, value, posterior)
        code, values = f"{code}{more}", values | numbers
    return Notice(code, values, suspect.recording if len(data) > 1 else "")


def _variant(name: str, value: float, posterior: Posterior) -> tuple[str, dict[str, float]]:
    data = posterior.recordings[0]
    if name in ("stretch", "shear"):
        return ("", {"stiffness": 1.0 / value}) if value > 0.0 else (" backwards", {})
    if name == "length":
        length = data.observations.length
        return ": longer" if value > 0.0 else ": shorter", {"change": length * abs(value), "length": length}
    if name == "push place":
        written = float(np.median(data.push_s))
        there = written + value
        return "" if 0.0 < there < _OUT else ": unknown", {"there": there, "written": written}
    if name == "force direction" and abs(value) > 1.0:  # rad, beyond the range of a linear model
        return ": far", {}
    if name == "axis scale" and abs(value) <= _OUT_OF_SCALE:
        ratio = (1.0 + abs(value)) / (1.0 - abs(value))
        return ": y" if value > 0.0 else ": x", {"excess": ratio - 1.0}
    known = posterior.layout.known
    section = name == "stiffness along" and known is not None and known.section is not None
    return " a section" if section else "", {}


def what_is_tested(finding: criticism.Finding, posterior: Posterior) -> Notice:
    """What a test is of, whether or not it stands out."""
    if finding.score.able or finding.score.suspect.kind == "trend":
        found = cause(finding, posterior)
        return replace(found, code="trend: tested") if found.code == "trend" else found
    return Notice("untestable", {"name": finding.score.suspect.name})


def unseen_place(posterior: Posterior) -> Notice | None:
    """The effect of a wrong place of the push, which hardly shows in the tags; None if nothing was pushed."""
    for one in posterior.criticism.findings:
        value = one.score.value
        if one.score.suspect.name == "push place" and np.all(np.isfinite(value)) and np.all(value != 0.0):
            length = posterior.recordings[0].observations.length
            share = _SLIP / length / abs(float(value[0]))
            values = {
                "slip": _SLIP,
                "change": float(np.expm1(share * one.shift)),
                "sds": share * one.sds,
                "allowed": max(data.observations.stated.place_sd for data in posterior.recordings),
                "noticed": -criticism.ALARM_WRITTEN * float(one.score.sd[0]) * length,  # about 3 sd
            }
            return Notice("unseen place", values)
    return None


def fitted_rms(posterior: Posterior) -> tuple[Array, ...]:
    """(m,) m of each recording: distance of the tags from the fit with all nuisances, the force log's slow error
    included; NaN for a tag never seen. Where there are no tags, of the few points that stand for an outline."""
    pairs = zip(posterior.recordings, posterior.slow, strict=True)
    return tuple(optimizer.recording_rms(data, now)[read_before_fit(data.observations)] for data, now in pairs)


def possible(posterior: Posterior) -> Posterior:
    """The posterior without the tests of impossible causes: places and axes of a push for poses under known loads, and
    hanging weights much heavier than the other loads."""
    critic = posterior.criticism
    kept = tuple(one for one in critic.findings if _can_be(one, posterior))
    return replace(posterior, criticism=replace(critic, findings=kept))


def _can_be(finding: criticism.Finding, posterior: Posterior) -> bool:
    suspect = finding.score.suspect
    whose = [one.observations for one in posterior.recordings]
    whose = [one for one in whose if suspect.recording in ("", one.source.name)]
    if suspect.name in _OF_THE_PUSH:
        return any(not one.static and np.any(one.force != 0.0) for one in whose)
    if suspect.name == "weight":
        return float(np.linalg.norm(finding.score.value)) <= max(_heaviest(one) for one in whose)
    return True


def _heaviest(one: Observations) -> float:
    """N, the most that could hang on a beam by mistake: twice its own weight or the largest force."""
    force = float(np.nanmax(np.linalg.norm(one.force, axis=1), initial=0.0))
    if one.known_loads is not None:
        force = max(force, float(np.nanmax(np.linalg.norm(one.known_loads.force, axis=2), initial=0.0)))
    return 2.0 * max(force, _G * one.stated.mass if np.isfinite(one.stated.mass) else 0.0)


def _miss(posterior: Posterior, name: str, tag: str, rms: float, motion: float) -> Notice:
    data = [one.observations for one in posterior.recordings]
    forced = any(np.any(one.force != 0.0) for one in data)
    code = "miss: poses" if all(one.static for one in data) else "miss: force" if forced else "miss: weight"
    return Notice(code, {"tag": tag, "rms": rms, "motion": motion}, _whose(posterior, name))


def _push_elsewhere(posterior: Posterior) -> list[Notice]:
    found, off = posterior.place, push_place.moved_off(posterior.layout, posterior.mean)
    if off > push_place.FAR and not (found is not None and found.accused):
        return [Notice("push moved", {"times": off})]
    if found is None or not (found.accused or found.open):
        return []
    likelier = "push likelier elsewhere" if found.mistaken > push_place.LIKELIER else "push place open"
    values = {"where": found.range, "written": found.written}
    return [Notice("push elsewhere" if found.accused else likelier, values)]


def _left_out(posterior: Posterior) -> list[Notice]:
    out = []
    for data, left_out in zip(posterior.recordings, posterior.left_out, strict=True):
        names = static_poses.pose_names(data.observations, left_out)
        if names:
            code = "pose left out" if len(names) == 1 else "poses left out"
            out.append(Notice(code, {"names": ", ".join(names)}, _whose(posterior, data.observations.source.name)))
    return out


def _test_notices(posterior: Posterior) -> tuple[Notice, ...]:
    able = possible(posterior)
    notices = criticism_notices(able)
    if posterior.criticism.trusted or not able.criticism.trusted:
        return notices
    return (Notice("unexplained"), *notices)


def _hanging(posterior: Posterior) -> list[Notice]:
    """A warning if a beam of this k(s), section and weight would hang far out of the plane, as no filmed beam does. A
    cantilever of mass m hangs down by `m g L^2 int (1 - s)^3 / (2 k) ds`, with k of the other direction: larger by the
    square of the ratio of the section's sizes."""
    one, s = posterior.recordings[0].observations, np.linspace(0.0, 1.0, 201)
    section, upright = one.stated.section, any(np.any(r.observations.gravity) for r in posterior.recordings)
    if section is None or section.shape != "rectangle" or one.static or upright:
        return []
    thick, deep = (np.interp(s, section.s, size) for size in (section.thickness, section.width))
    light = _LIGHTEST * one.length * float(np.trapezoid(thick * deep, s))
    mass = one.stated.mass if np.isfinite(one.stated.mass) else light
    bends = (1.0 - s) ** 3 / (2.0 * posterior.beam.stiffness(s)) * (thick / deep) ** 2
    sag = mass * _G * one.length**2 * float(np.trapezoid(bends, s))
    return [] if sag < _FAR_DOWN * one.length else [Notice("hanging", {"mass": mass, "sag": sag})]


def _free_clamp(posterior: Posterior) -> list[Notice]:
    seen = [data.observations for data in posterior.recordings]
    every = [o if o.static else replace(o, stated=replace(o.stated, clamp_sd=np.nan)) for o in seen]
    usual = max(parameters.clamp_sd(o) for o in every)
    sd = max((float(b.prior_sd[0]) for b in posterior.layout.blocks if b.name == "clamp"), default=usual)
    return [] if sd <= 1.001 * usual else [Notice("free clamp", {"sd": sd, "usual": usual})]


def _far_nuisances(posterior: Posterior) -> list[Notice]:
    struck = {(f.score.suspect.name, f.score.suspect.tag) for f in posterior.criticism.striking}
    ids = posterior.recordings[0].observations.tag_id[posterior.recordings[0].tags].tolist()
    skipped = {"stiffness", "force", allowances.BETWEEN}
    skipped |= {a.name for data in posterior.recordings for a in data.allowances if a.enters == "poses" and a.sized}
    out = []
    for block in posterior.layout.blocks:
        if block.start < 0 or block.name in skipped:
            continue
        away = np.abs(posterior.mean[block.where]) / block.prior_sd
        for i in np.flatnonzero(away > _FAR):
            tag = ids[i] if block.name in _OF_A_TAG else -1
            told = block.name == "place" and away[i] > push_place.FAR
            if not told and (_TESTED_AS.get(block.name, block.name), tag) not in struck:
                out.append(Notice("far nuisance", {"name": block.labels[i], "times": float(away[i])}))
    return out


def _loud(posterior: Posterior) -> list[Notice]:
    out = []
    for data, noise in zip(posterior.recordings, posterior.optimum.hyperparameters.noise, strict=True):
        if noise.marker > _LOUD:
            o = data.observations
            code = "loud tags" if not o.static else "loud points" if o.sd_known else "loud guessed points"
            out.append(Notice(code, {"times": noise.marker}, _whose(posterior, o.source.name)))
    return out


def _whose(posterior: Posterior, name: str) -> str:
    return name if len(posterior.recordings) > 1 else ""


PLACES = np.linspace(0.0, 1.0, 121)  # of the centre line


@one_blas_thread
def explained(posterior: Posterior) -> tuple[Explained, ...]:
    """Every recording of a fit, in the frames that it used."""
    parts = zip(posterior.recordings, posterior.slow, fitted_rms(posterior), strict=True)
    return tuple(_one(posterior, recording, prediction, rms) for recording, prediction, rms in parts)


def _one(posterior: Posterior, data: fit_data.FitData, prediction: Prediction, rms: Array) -> Explained:
    observations, x, layout = data.observations, posterior.mean, posterior.layout
    used = slice(0, int(np.sum(data.frames)))  # beyond them stands the beam at rest
    scale, origin = 1.0 + layout.get(x, "scale", data.number), layout.get(x, "origin", data.number)
    kept = read_before_fit(observations)
    measured = np.concatenate([prediction.pose[..., :2] + data.off(prediction.pose), data.measured[..., 2:]], axis=-1)
    comparison = Comparison(
        name=observations.source.name,
        frame=observations.frame[data.frames],
        time=observations.time[data.frames],
        tag_id=observations.tag_id[kept],
        marker_s=observations.marker_s[kept],
        measured=_points(data, layout, x, measured)[used][:, kept],
        predicted=_points(data, layout, x, prediction.pose)[used][:, kept],
        force=prediction.force[used],
        push_s=data.push_s[used],
        stable=prediction.solved.stable[used],
        rms=rms,
        sensor_rms=np.full(len(kept), np.nan),
        likely_rms=np.full(len(kept), np.nan),
        static=observations.static,
    )
    return Explained(comparison, scale * prediction.solved.xy(PLACES)[used] + origin, data.force[used])


def _points(data: fit_data.FitData, layout: parameters.Layout, x: Array, poses: Array) -> Array:
    """(F, m, 2) m, poses (F, m, 3) counted from the clamp, and at their rulers."""
    points, zeros = poses[..., :2].copy(), layout.get(x, "zero", data.number)
    for (i, c), zero in zip(frames.zeroed_coordinates(data.observations), zeros, strict=True):
        points[:, i, c] += zero
    if data.rulers is not None:
        points[..., 0] = np.where(np.isfinite(points[..., 1]), data.rulers, np.nan)
    return points
