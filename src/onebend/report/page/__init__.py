"""The self-contained page."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup, escape

from onebend.beam.stiffness import UncertainStiffness, half_width_words
from onebend.files.publish import this_onebend
from onebend.learning.frequencies import compared_frequencies, worst_off
from onebend.learning.outcome import Comparison
from onebend.learning.posterior import Posterior, loop_of
from onebend.learning.run import Run
from onebend.learning.verdict import fitted_rms, possible, unseen_place
from onebend.records import Array, Observations
from onebend.report import confidence, sentences
from onebend.report.pictures import six_digits
from onebend.report.sentences import (
    all_remarks,
    change_words,
    grown_words,
    millimetres,
    odds,
    posture_words,
    significant,
    words,
)
from onebend.report.verdict import verdict_of
from onebend.text_files import one_line, to_json

COMMON = "onebend.report.page"


def render(
    package: str, name: str, figures: Mapping[str, bytes], content: Mapping[str, Any], *, scripts: Sequence[str] = ()
) -> str:
    """Template `name` of `package` as HTML, with `look` (CSS), `figures` (base64 PNGs by name) and `content`. Only
    `scripts` of this folder may run; they read `content["data"]` (JSON)."""

    look = Markup(page_file(COMMON, "look.css"))
    encoded = {key: base64.b64encode(png).decode("ascii") for key, png in figures.items()}
    script = Markup("\n".join(page_file(COMMON, file) for file in scripts))
    given = {"look": look, "figures": encoded, "script": script, "policy": _policy(script), "by": this_onebend()}
    return _environment(package, name).get_template(name).render(**given, **content)


@cache
def _environment(package: str, name: str) -> Environment:
    """Compiled once."""

    def source(file: str) -> str:
        return page_file(package if file == name else COMMON, file)

    environment = Environment(
        loader=FunctionLoader(source), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters |= {"code": code_in, "line": one_line, "json": to_json, "bic": sentences.bic_words}
    environment.filters |= {"mm": millimetres, "significant": significant, "posture": posture_words}
    environment.filters |= {"odds": odds, "change": change_words, "grown": grown_words}
    return environment


def code_in(text: str) -> Markup:
    """Escaped text; parts in backticks as code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def _policy(script: str) -> str:
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    allowed = f"'sha256-{digest}'" if script else "'none'"
    return f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src {allowed}"


def page_file(package: str, file: str) -> str:
    return files(package).joinpath(file).read_text(encoding="utf-8")


Card = tuple[str, str, str]  # name, value and note


def cards(findings: Run) -> list[Card]:
    recording, (low, high), area = findings.recordings[0], confidence.stiffness_range(findings), findings.beam.length
    k = sentences.span(low, high, " … ")
    bending = sentences.span(1e6 * area * low, 1e6 * area * high, " … ")
    rows = [("bending stiffness k(s)", f"{k}\u00a0N\u00a0m", f"EI {bending} N mm²"), *_modulus_card(findings)]
    if findings.posterior is not None:
        verdict = verdict_of(findings)
        rows += [band_card(findings.posterior.stiffness), ("verdict", verdict.grade, verdict.rests_on)]
    rows.append(_training_card(findings))
    seen = [one for one in findings.validations if np.isfinite(one.rms).any()]  # not of frequencies alone
    if seen:
        worst = max(seen, key=lambda comparison: np.max(np.nan_to_num(comparison.rms)))
        others = len(seen)
        which = f"worst of {others} other recordings ({worst.name})" if others > 1 else f"on {worst.name}"
        rows.append(("validation, worst tag", sentences.worst_tag(worst), f"RMS, {which}{_noise_of(worst)}"))
    if recording.source.clean_force is not None:
        size = np.linalg.norm(recording.force[recording.loaded], axis=1)
        noise = 1000.0 * float(np.max(recording.source.clean_force.noise_sd))
        largest = f"{significant(np.nanmax(size, initial=0.0))} N"
        rows.append(("largest force", largest, f"noise left in it: {significant(noise, 2)} mN (sd)"))
    return rows


def _noise_of(validation: Comparison) -> str:
    noise = validation.sensor_rms[int(np.argmax(np.nan_to_num(validation.rms)))]
    return f"; force noise {millimetres(float(noise))} mm" if np.isfinite(noise) and noise > 0.0 else ""


def _training_card(findings: Run) -> Card:
    if findings.posterior is not None and sentences.only_frequencies(findings.recordings):
        swings = findings.posterior.frequencies
        note = f"of {len(compared_frequencies(swings))} measured, from those of the fit"
        return "worst frequency", f"{significant(worst_off(swings), 2)} sd", note
    rms = [one.rms for one in findings.trainings] if findings.posterior is None else fitted_rms(findings.posterior)
    which = int(np.argmax([float(np.max(np.nan_to_num(values))) for values in rms]))
    logged = findings.trainings[which]
    of = "RMS under the force as logged" if findings.posterior is None else "RMS of the fit"
    note = f"{of}, over {len(logged.frame)} {sentences.words_of(findings.recordings[which]).frames}"
    return "learned recording, worst tag", sentences.worst_tag(replace(logged, rms=rms[which])), note


def _modulus_card(findings: Run) -> list[Card]:
    measured = confidence.measured_beam(findings)
    found, one = confidence.modulus_range(measured), confidence.one_modulus_words(measured)
    if one:
        note = f"95 %; mean along the beam, k(s) stated to go with the section; {found} at its places"
        return [("Young's modulus E", one, note)]
    note = "E(s) = k L / I, where k is identified, by the section that recording.toml states"
    return [("Young's modulus E(s)", found, note)] if found else []


def band_card(uncertain: UncertainStiffness) -> Card:
    """Width of the band, identified places, trust."""
    what, ranges = "k(s) is known to", confidence.identified_ranges(uncertain)
    if uncertain.doubts:
        return what, "NOT TO BE TRUSTED", "; ".join(uncertain.doubts)
    if not ranges:
        return what, "not identified", "at no place to a factor of 1.5"
    wide, places = confidence.typical_half_width(uncertain), confidence.identified_words(ranges)
    return what, half_width_words(wide), f"95 %, median over the identified s = {places}"


# Data of the page's script.

SCRIPTS = ("beam.js", "curve.js", "bend.js", "film.js", "page.js")  # one script in this order
PLACES = 201  # of the curves


def script_data(findings: Run, film: Mapping[str, Any] | None = None) -> Markup:
    """JSON that cannot end its script element."""
    data = {"curve": _curve(findings), "bend": _bend(findings), "film": film}
    text = to_json(data, ascii_only=True, readable=False)
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


def _curve(findings: Run) -> dict[str, Any]:
    """In N m."""
    s = np.linspace(0.0, 1.0, PLACES)
    beam, posterior, learned = findings.beam, findings.posterior, findings.learned
    k = np.asarray(beam.stiffness(s))
    found: dict[str, Any] = {
        "length_m": beam.length,
        "tag_words": sentences.axis_words(findings.trainings[0].tag_id.tolist()),
        "tag_s": six_digits(findings.trainings[0].marker_s),
        "k_N_m": six_digits(k),
        "bands": [],
        "top_N_m": float(max(np.max(k), 0.0)),
        "lowest_N_m": float(min(np.min(k), 0.0)),
    }
    if posterior is None:
        return found
    uncertain = posterior.stiffness
    found |= {"known": uncertain.band(s).identified.tolist(), "top_N_m": sentences.highest_shown(uncertain)}
    found |= {"bands": _bands(uncertain, s), "unknown": "not to be trusted" if uncertain.doubts else "not identified"}
    if learned is not None:
        found["regression_N_m"] = six_digits(np.asarray(learned.beam.stiffness(s)))
    return found


def _bands(uncertain: UncertainStiffness, s: Array) -> list[dict[str, Any]]:
    bands = [(level, strength, uncertain.band(s, level)) for level, strength in sentences.LEVELS]
    return [
        {"level": level, "strength": strength, "low_N_m": six_digits(band.low), "high_N_m": six_digits(band.high)}
        for level, strength, band in bands
    ]


def _bend(findings: Run) -> dict[str, Any] | None:
    beam, s = findings.beam, np.linspace(0.0, 1.0, PLACES)
    k, first = np.asarray(beam.stiffness(s)), findings.recordings[0]
    if np.min(k) <= 0.0:
        return None
    forces = np.nan_to_num(np.concatenate([one.force for one in findings.trainings]))
    hardest = forces[np.argmax(np.linalg.norm(forces, axis=1))]
    largest = float(np.linalg.norm(hardest))
    gravity = np.nan_to_num(np.mean(first.gravity, axis=0))
    mass = np.asarray(beam.mass_per_length(s))
    # without its own load: one that turns the tip by about half a radian
    usual = float(1.0 / np.mean((1.0 - s) ** 2 / k) / beam.length)
    places = np.concatenate([one.push_s[np.isfinite(one.push_s)] for one in findings.trainings])
    return {
        "length_m": beam.length,
        "clamp_rad": beam.clamp_angle,
        "k_N_m": six_digits(k),
        "q0_rad": six_digits(np.asarray(beam.rest_curvature(s))),
        "mass_kg_m": six_digits(mass if np.any(gravity) else np.zeros_like(mass)),
        "masses": [[one.s, one.mass] for one in beam.masses],
        "gravity_m_s2": gravity.tolist(),
        "largest_N": largest,
        "force_N": largest or usual,
        "first_N": (hardest if largest > 0.0 else np.array([0.0, 0.5 * usual])).tolist(),
        "at_s": float(np.max(places, initial=0.0)) or 1.0,
    }


FAMILIES = {"gaussians": "Gaussians", "powers": "powers of s"}
METHODS = {"regression": "regression", "paper": "the paper's literal regression"}


def page(
    findings: Run,
    figures: Mapping[str, bytes],
    *,
    made_from: Mapping[str, Any] | None = None,
    film: Mapping[str, Any] | None = None,
) -> str:
    """The report as HTML. `figures`: PNGs by name, as from `figures.draw_all`; missing ones are left out. `made_from`:
    the `provenance` of `summary.json`. `film`: of `pictures.film_strip`."""
    content = {"made_from": made_from, "film": film, "data": script_data(findings, film), **_content(findings)}
    return render(COMMON, "page.html", figures, content, scripts=SCRIPTS)


def _content(findings: Run) -> dict[str, Any]:
    learned, first, logged = findings.learned, findings.recordings[0], findings.trainings[0]
    remarks = [{"recording": whose, **remark.as_dict(), "docs": remark.docs} for whose, remark in all_remarks(findings)]
    s, posterior, measured = np.linspace(0.0, 1.0, 11), findings.posterior, confidence.measured_beam(findings)
    band = None if posterior is None else posterior.band(s)
    return {
        "name": sentences.name_of(findings),
        "several": len(findings.recordings) > 1,
        "length": f"{1000 * first.length:.4g} mm",
        "frames": " and ".join(sentences.learned_from(recording) for recording in findings.recordings),
        "words": sentences.words_of(first),
        "heavy": bool(np.any(first.gravity)),
        "static": posterior is not None and sentences.only_static(findings.recordings),
        "method": "" if learned is None else METHODS.get(learned.method, learned.method),
        "family": "" if learned is None else FAMILIES.get(learned.family, learned.family),
        "chosen": None if learned is None else learned.trials[learned.chosen],
        "cards": cards(findings),
        "verdict": verdict_of(findings),
        "warnings": [row for row in remarks if row["level"] == "warning"],
        "remarks": remarks,
        "fit": None if posterior is None else _fit(posterior, findings.recordings),
        "places": s,
        "k": findings.beam.stiffness(s),
        "band": band,
        "halves": () if band is None else confidence.half_widths(band),
        "regression": None if learned is None else learned.beam.stiffness(s),
        "area": 1e6 * findings.beam.length,
        "modulus": confidence.modulus_rows(measured, s),
        "modulus_words": confidence.modulus_words(measured),
        "one_modulus": bool(confidence.one_modulus_words(measured)),
        "tags": [sentences.tag_words(logged, i) for i in range(len(logged.tag_id))],
        "swings": () if posterior is None else compared_frequencies(posterior.frequencies),
        "only_swings": sentences.only_frequencies(findings.recordings),
        "trainings": findings.trainings,
        "under": [sentences.words_of(recording).under for recording in findings.recordings],
        "trials": () if learned is None else learned.trials,
        "validations": findings.validations,
        "inputs": [(recording.source.name, sentences.inputs(recording)) for recording in findings.recordings],
        "assumptions": sentences.assumptions(findings),
    }


def _fit(posterior: Posterior, recordings: Sequence[Observations]) -> dict[str, Any]:
    unseen, critic = unseen_place(possible(posterior)), possible(posterior).criticism
    return {
        "doubts": "; ".join(posterior.doubts),
        "holds": posterior.criticism.trusted,
        "allowances": posterior.attributions,
        "tests": confidence.model_tests(posterior),
        "alarms": critic.alarms,
        "testable": bool(critic.able),
        "alarm": confidence.alarm_words(posterior),
        "unseen": "" if unseen is None else words(unseen),
        "blind": confidence.unidentified_words(posterior.stiffness, len(recordings)),
        "gain": " ".join(
            [
                confidence.scale_words(posterior.gain_sd, recordings, loop_of(posterior.layout, posterior.mean)),
                *confidence.load_error_words(posterior.load_error),
                confidence.mounting_words(posterior),
            ]
        ),
        "stopped": confidence.stop_words(posterior),
        "units": confidence.UNITS,
        "nuisances": posterior.nuisances(),
        "tradeoffs": confidence.tradeoff_words(posterior),
        "fitted": fitted_rms(posterior),
    }
