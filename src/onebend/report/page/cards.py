"""The headline figures of a report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.beam.profiles.uncertain import UncertainStiffness, half_width_words
from onebend.learning.frequencies.compared import compared_frequencies, worst_off
from onebend.learning.outcome import Comparison
from onebend.learning.verdict import fitted_rms
from onebend.report.confidence import identified_ranges, identified_words, stiffness_range, typical_half_width
from onebend.report.findings import Findings
from onebend.report.kinds import only_frequencies, words_of
from onebend.report.modulus import measured_beam, modulus_range, one_modulus_words
from onebend.report.verdict import Verdict, verdict_of
from onebend.report.wording import millimetres, significant, span, worst_tag


def cards(findings: Findings) -> list[dict[str, str]]:
    """What it is, its value, and a note, one a card."""
    recording = findings.recordings[0]
    rows = [_stiffness_card(findings), *_modulus_card(findings)]
    if findings.posterior is not None:
        rows += [band_card(findings.posterior.stiffness), verdict_card(verdict_of(findings))]
    rows.append(_training_card(findings))
    seen = [one for one in findings.validations if np.isfinite(one.rms).any()]  # not of frequencies alone
    if seen:
        worst = max(seen, key=lambda comparison: np.max(np.nan_to_num(comparison.rms)))
        others = len(seen)
        which = f"worst of {others} other recordings ({worst.name})" if others > 1 else f"on {worst.name}"
        note = f"RMS, {which}{_noise_of(worst)}"
        rows.append({"what": "validation, worst tag", "value": worst_tag(worst), "note": note})
    if recording.source.clean_force is not None:
        size = np.linalg.norm(recording.force[recording.loaded], axis=1)
        noise = 1000.0 * float(np.max(recording.source.clean_force.noise_sd))
        note = f"noise left in it: {significant(noise, 2)} mN (sd)"
        rows.append({"what": "largest force", "value": f"{significant(np.nanmax(size, initial=0.0))} N", "note": note})
    return rows


def _noise_of(validation: Comparison) -> str:
    """What the force noise alone does to the worst tag; a fit is closer, for it takes that noise out of the log."""
    noise = validation.sensor_rms[int(np.argmax(np.nan_to_num(validation.rms)))]
    return f"; force noise {millimetres(float(noise))} mm" if np.isfinite(noise) and noise > 0.0 else ""


def verdict_card(verdict: Verdict) -> dict[str, str]:
    """The grade, and what k(s) rests on."""
    return {"what": "verdict", "value": verdict.grade, "note": verdict.rests_on}


def _training_card(findings: Findings) -> dict[str, str]:
    """The residual at the tags that the beam was learned from: of the fit, where there is one."""
    if findings.posterior is not None and only_frequencies(findings.recordings):
        swings = findings.posterior.frequencies
        note = f"of {len(compared_frequencies(swings))} measured, from those of the fit"
        return {"what": "worst frequency", "value": f"{significant(worst_off(swings), 2)} sd", "note": note}
    what = "learned recording, worst tag"
    rms = [one.rms for one in findings.trainings] if findings.posterior is None else fitted_rms(findings.posterior)
    which = int(np.argmax([float(np.max(np.nan_to_num(values))) for values in rms]))
    logged = findings.trainings[which]
    of = "RMS under the force as logged" if findings.posterior is None else "RMS of the fit"
    note = f"{of}, over {len(logged.frame)} {words_of(findings.recordings[which]).frames}"
    return {"what": what, "value": worst_tag(replace(logged, rms=rms[which])), "note": note}


def _stiffness_card(findings: Findings) -> dict[str, str]:
    low, high = stiffness_range(findings)
    area = 1e6 * findings.beam.length
    return {
        "what": "bending stiffness k(s)",
        "value": f"{span(low, high, ' … ')}\u00a0N\u00a0m",
        "note": f"EI {span(area * low, area * high, ' … ')} N mm²",
    }


def _modulus_card(findings: Findings) -> list[dict[str, str]]:
    """Young's modulus, where the section was measured."""
    measured = measured_beam(findings)
    found, one = modulus_range(measured), one_modulus_words(measured)
    if one:
        note = f"95 %; mean along the beam, k(s) stated to go with the section; {found} at its places"
        return [{"what": "Young's modulus E", "value": one, "note": note}]
    note = "E(s) = k L / I, where k is identified, by the section that recording.toml states"
    return [{"what": "Young's modulus E(s)", "value": found, "note": note}] if found else []


def band_card(uncertain: UncertainStiffness) -> dict[str, str]:
    """The width of the band, where k is identified, and whether the fit can be trusted."""
    what = "k(s) is known to"
    if uncertain.doubts:
        return {"what": what, "value": "NOT TO BE TRUSTED", "note": "; ".join(uncertain.doubts)}
    ranges = identified_ranges(uncertain)
    if not ranges:
        return {"what": what, "value": "not identified", "note": "at no place to a factor of 1.5"}
    wide = typical_half_width(uncertain)
    return {
        "what": what,
        "value": half_width_words(wide),
        "note": f"95 %, median over the identified s = {identified_words(ranges)}",
    }
