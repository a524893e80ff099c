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
from onebend.report.pictures import FilmStrip
from onebend.report.sentences import all_remarks, millimetres, posture_words, significant, words
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


def cards(findings: Run) -> list[dict[str, str]]:
    """Name, value and note of each card."""
    recording = findings.recordings[0]
    rows = [_stiffness_card(findings), *_modulus_card(findings)]
    if findings.posterior is not None:
        verdict = verdict_of(findings)
        rows.append(band_card(findings.posterior.stiffness))
        rows.append({"what": "verdict", "value": verdict.grade, "note": verdict.rests_on})
    rows.append(_training_card(findings))
    seen = [one for one in findings.validations if np.isfinite(one.rms).any()]  # not of frequencies alone
    if seen:
        worst = max(seen, key=lambda comparison: np.max(np.nan_to_num(comparison.rms)))
        others = len(seen)
        which = f"worst of {others} other recordings ({worst.name})" if others > 1 else f"on {worst.name}"
        note = f"RMS, {which}{_noise_of(worst)}"
        rows.append({"what": "validation, worst tag", "value": sentences.worst_tag(worst), "note": note})
    if recording.source.clean_force is not None:
        size = np.linalg.norm(recording.force[recording.loaded], axis=1)
        noise = 1000.0 * float(np.max(recording.source.clean_force.noise_sd))
        note = f"noise left in it: {significant(noise, 2)} mN (sd)"
        rows.append({"what": "largest force", "value": f"{significant(np.nanmax(size, initial=0.0))} N", "note": note})
    return rows


def _noise_of(validation: Comparison) -> str:
    noise = validation.sensor_rms[int(np.argmax(np.nan_to_num(validation.rms)))]
    return f"; force noise {millimetres(float(noise))} mm" if np.isfinite(noise) and noise > 0.0 else ""


def _training_card(findings: Run) -> dict[str, str]:
    if findings.posterior is not None and sentences.only_frequencies(findings.recordings):
        swings = findings.posterior.frequencies
        note = f"of {len(compared_frequencies(swings))} measured, from those of the fit"
        return {"what": "worst frequency", "value": f"{significant(worst_off(swings), 2)} sd", "note": note}
    what = "learned recording, worst tag"
    rms = [one.rms for one in findings.trainings] if findings.posterior is None else fitted_rms(findings.posterior)
    which = int(np.argmax([float(np.max(np.nan_to_num(values))) for values in rms]))
    logged = findings.trainings[which]
    of = "RMS under the force as logged" if findings.posterior is None else "RMS of the fit"
    note = f"{of}, over {len(logged.frame)} {sentences.words_of(findings.recordings[which]).frames}"
    return {"what": what, "value": sentences.worst_tag(replace(logged, rms=rms[which])), "note": note}


def _stiffness_card(findings: Run) -> dict[str, str]:
    low, high = confidence.stiffness_range(findings)
    area = 1e6 * findings.beam.length
    return {
        "what": "bending stiffness k(s)",
        "value": f"{sentences.span(low, high, ' … ')}\u00a0N\u00a0m",
        "note": f"EI {sentences.span(area * low, area * high, ' … ')} N mm²",
    }


def _modulus_card(findings: Run) -> list[dict[str, str]]:
    measured = confidence.measured_beam(findings)
    found, one = confidence.modulus_range(measured), confidence.one_modulus_words(measured)
    if one:
        note = f"95 %; mean along the beam, k(s) stated to go with the section; {found} at its places"
        return [{"what": "Young's modulus E", "value": one, "note": note}]
    note = "E(s) = k L / I, where k is identified, by the section that recording.toml states"
    return [{"what": "Young's modulus E(s)", "value": found, "note": note}] if found else []


def band_card(uncertain: UncertainStiffness) -> dict[str, str]:
    """Width of the band, identified places, trust."""
    what = "k(s) is known to"
    if uncertain.doubts:
        return {"what": what, "value": "NOT TO BE TRUSTED", "note": "; ".join(uncertain.doubts)}
    ranges = confidence.identified_ranges(uncertain)
    if not ranges:
        return {"what": what, "value": "not identified", "note": "at no place to a factor of 1.5"}
    wide = confidence.typical_half_width(uncertain)
    return {
        "what": what,
        "value": half_width_words(wide),
        "note": f"95 %, median over the identified s = {confidence.identified_words(ranges)}",
    }


# Data of the page's script.

SCRIPTS = ("beam.js", "curve.js", "bend.js", "film.js", "page.js")  # one script in this order
PLACES = 201  # of the curves


def script_data(findings: Run, film: FilmStrip | None = None) -> Markup:
    """JSON that cannot end its script element."""
    data = {"curve": _curve(findings), "bend": _bend(findings), "film": None if film is None else _film(film)}
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
        "tag_s": _short(findings.trainings[0].marker_s),
        "k_N_m": _short(k),
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
        found["regression_N_m"] = _short(np.asarray(learned.beam.stiffness(s)))
    return found


def _bands(uncertain: UncertainStiffness, s: Array) -> list[dict[str, Any]]:
    bands = [(level, strength, uncertain.band(s, level)) for level, strength in sentences.LEVELS]
    return [
        {"level": level, "strength": strength, "low_N_m": _short(band.low), "high_N_m": _short(band.high)}
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
        "k_N_m": _short(k),
        "q0_rad": _short(np.asarray(beam.rest_curvature(s))),
        "mass_kg_m": _short(mass if np.any(gravity) else np.zeros_like(mass)),
        "masses": [[one.s, one.mass] for one in beam.masses],
        "gravity_m_s2": gravity.tolist(),
        "largest_N": largest,
        "force_N": largest or usual,
        "first_N": (hardest if largest > 0.0 else np.array([0.0, 0.5 * usual])).tolist(),
        "at_s": float(np.max(places, initial=0.0)) or 1.0,
    }


def _film(film: FilmStrip) -> dict[str, Any]:
    frames = [
        {
            "picture": "data:image/jpeg;base64," + base64.b64encode(one.jpeg).decode("ascii"),
            "frame": one.frame,
            "time_s": round(one.time, 3),
            "beam_px": one.beam.round(1).tolist(),
            "band_px": [*one.band[0].round(1).tolist(), *one.band[1, ::-1].round(1).tolist()],
            "tags_px": [point.round(1).tolist() for point in one.tags if np.isfinite(point).all()],
            "arrow_px": one.arrow.round(1).tolist(),
            "force_N": _short(one.force),
        }
        for one in film.frames
    ]
    return {"width": film.width, "height": film.height, "frames": frames}


def _short(values: Array) -> list[float]:
    """Six digits, for a smaller page."""
    return [float(f"{value:.6g}") for value in values]


FAMILIES = {"gaussians": "Gaussians", "powers": "powers of s"}
METHODS = {"regression": "regression", "paper": "the paper's literal regression"}


def page(
    findings: Run,
    figures: Mapping[str, bytes],
    *,
    made_from: Mapping[str, Any] | None = None,
    film: FilmStrip | None = None,
) -> str:
    """The report as HTML. `figures`: PNGs by name, as from `figures.draw_all`; missing ones are left out. `made_from`:
    the `provenance` of `summary.json`."""
    content = {"made_from": made_from, "film": film, "data": script_data(findings, film), **_content(findings)}
    return render(COMMON, "page.html", figures, content, scripts=SCRIPTS)


def _content(findings: Run) -> dict[str, Any]:
    learned, first, logged = findings.learned, findings.recordings[0], findings.trainings[0]
    remarks = [{"recording": whose, **remark.as_dict(), "docs": remark.docs} for whose, remark in all_remarks(findings)]
    return {
        "name": sentences.name_of(findings),
        "several": len(findings.recordings) > 1,
        "length": f"{1000 * first.length:.4g} mm",
        "frames": " and ".join(sentences.learned_from(recording) for recording in findings.recordings),
        "words": sentences.words_of(first),
        "heavy": bool(np.any(first.gravity)),
        "static": findings.posterior is not None and sentences.only_static(findings.recordings),
        "method": "" if learned is None else METHODS.get(learned.method, learned.method),
        "family": "" if learned is None else FAMILIES.get(learned.family, learned.family),
        "chosen": None if learned is None else learned.trials[learned.chosen],
        "cards": cards(findings),
        "verdict": verdict_of(findings),
        "warnings": [row for row in remarks if row["level"] == "warning"],
        "remarks": remarks,
        "fit": None if findings.posterior is None else _fit(findings.posterior, findings.recordings),
        **_stiffness_rows(findings),
        "modulus": confidence.modulus_rows(confidence.measured_beam(findings), np.linspace(0.0, 1.0, 11)),
        "modulus_words": confidence.modulus_words(confidence.measured_beam(findings)),
        "one_modulus": bool(confidence.one_modulus_words(confidence.measured_beam(findings))),
        "tags": [sentences.tag_words(logged, i) for i in range(len(logged.tag_id))],
        "swings": () if findings.posterior is None else compared_frequencies(findings.posterior.frequencies),
        "only_swings": sentences.only_frequencies(findings.recordings),
        "trainings": findings.trainings,
        "learned_figures": _learned_captions(findings),
        "trials": () if learned is None else learned.trials,
        "validations": findings.validations,
        "validation_figures": _validation_captions(findings.validations),
        "inputs": [(recording.source.name, sentences.inputs(recording)) for recording in findings.recordings],
        "assumptions": sentences.assumptions(findings),
    }


def _fit(posterior: Posterior, recordings: Sequence[Observations]) -> dict[str, Any]:
    unseen = unseen_place(possible(posterior))
    return {
        "doubts": "; ".join(posterior.doubts),
        "holds": posterior.criticism.trusted,
        "allowances": confidence.allowance_rows(posterior),
        "tests": confidence.model_test_rows(posterior),
        "testable": bool(possible(posterior).criticism.able),
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
        "nuisances": confidence.nuisance_rows(posterior.nuisances()),
        "tradeoffs": confidence.tradeoff_words(posterior),
        "fitted": fitted_rms(posterior),
    }


def _stiffness_rows(findings: Run) -> dict[str, Any]:
    """At eleven places: k, its band, and that of the paper's regression."""
    s, learned = np.linspace(0.0, 1.0, 11), findings.learned
    band = None if findings.posterior is None else findings.posterior.band(s)
    return {
        "places": s,
        "k": findings.beam.stiffness(s),
        "band": band,
        "halves": () if band is None else confidence.half_widths(band),
        "regression": None if learned is None else learned.beam.stiffness(s),
        "area": 1e6 * findings.beam.length,
    }


def _validation_captions(comparisons: Sequence[Comparison]) -> list[tuple[str, str]]:
    captions = []
    for i, comparison in enumerate(comparisons, start=1):
        captions.append((f"validation-{i}-shapes", f"{comparison.name}: simulated beam and measured tags."))
        captions.append(
            (f"validation-{i}-residuals", f"{comparison.name}: distance between measured and simulated tags.")
        )
    return captions


def _learned_captions(findings: Run) -> list[tuple[str, str]]:
    captions = []
    for i, comparison in enumerate(findings.trainings[1:], start=2):
        words = sentences.words_of(findings.recordings[i - 1])
        captions.append((f"learned-{i}-shapes", f"{comparison.name}: the beam and measured tags."))
        captions.append((f"learned-{i}-fitted", f"{comparison.name}: what the fit leaves of the tags."))
        captions.append((f"learned-{i}-residuals", f"{comparison.name}: measured to simulated {words.under}."))
    return captions
