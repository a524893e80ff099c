"""Writes the files of learning results."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from onebend.files.publish import headed, this_onebend, write_summary
from onebend.learning.design import PLACES, Plan, Proposal
from onebend.learning.instruments import instruments_if_pushed, setup_of
from onebend.learning.outcome import Comparison, Learned, stated_section
from onebend.learning.posterior import Posterior, tradeoffs, with_level
from onebend.learning.run import Run
from onebend.learning.swing import FoundFrequencies, SwingFit
from onebend.learning.verdict import fitted_rms, possible
from onebend.records import Observations
from onebend.report.confidence import identified_ranges
from onebend.report.page import page
from onebend.report.pictures import Pictures
from onebend.report.sentences import all_remarks, pair_remarks, worded, words
from onebend.report.verdict import validation_verdict, verdict_of
from onebend.results.model import FILE_NAME, StoredModel, model_text, origin_of, stiffness_summary
from onebend.results.observations_file import save_observations
from onebend.results.tables import write_markers, write_nuisances, write_selection, write_stiffness, write_validation

Writer = Callable[[Path], None]


def learned_writer(
    findings: Run,
    pictures: Pictures | None,
    summary: Mapping[str, Any],
    *,
    made_from: Mapping[str, Any] = {},
    tables: Writer | None = None,
) -> Writer:
    """Writer for `publish`. `pictures`: None for no report. `made_from`: from `provenance`. `tables`: default
    `tables_writer`."""
    write_tables = tables or tables_writer(findings)

    def write(folder: Path) -> None:
        write_tables(folder)
        if pictures is not None:
            shown = made_from.get("provenance")
            html = page(findings, pictures.drawn, made_from=shown, film=pictures.film)
            (folder / "report.html").write_text(html, encoding="utf-8")
            pictures.write(folder / "figures")
        write_summary(folder, summary)

    return write


def tables_writer(findings: Run) -> Writer:
    """Writes model, tables and observations, which are computed once."""
    made: dict[str, bytes] = {}

    def write(folder: Path) -> None:
        if not made:
            _write_tables(folder, findings)
            made.update({path.name: path.read_bytes() for path in folder.iterdir()})
        else:
            for name, content in made.items():
                (folder / name).write_bytes(content)

    return write


def _write_tables(folder: Path, findings: Run) -> None:
    learned, posterior = findings.learned, findings.posterior
    uncertain = None if posterior is None else posterior.stiffness
    origin = origin_of(learned, posterior, findings.trainings)
    bench, setup = (None, None) if posterior is None else (instruments_if_pushed(posterior), setup_of(posterior))
    beam, section = findings.beam, stated_section(findings.recordings)
    stored = StoredModel(beam, origin, uncertain, bench, setup, section=section)
    (folder / FILE_NAME).write_text(model_text(stored, written_by=this_onebend()), encoding="utf-8")
    write_stiffness(folder / "stiffness.csv", beam, uncertain, section)
    if learned is not None:
        write_selection(folder / "selection.csv", learned)
    if posterior is not None:
        write_nuisances(folder / "nuisances.csv", posterior.nuisances())
    write_markers(folder / "markers.csv", (*findings.trainings, *findings.validations))
    if findings.validations:
        write_validation(folder / "validation.csv", findings.validations)
    for i, recording in enumerate(findings.recordings, start=1):
        save_observations(folder / f"observations{'' if i == 1 else f'-{i}'}.parquet", recording)


def write_comparisons(folder: Path, comparisons: Sequence[Comparison]) -> None:
    """`validation.csv` and `markers.csv`."""
    write_validation(folder / "validation.csv", comparisons)
    write_markers(folder / "markers.csv", comparisons)


# `summary.json`: SI units; `null` for unknown numbers.

LEARN_FORMAT = "onebend-learn-1"
VALIDATE_FORMAT = "onebend-validate-1"
PLAN_FORMAT = "onebend-plan-1"
DAMP_FORMAT = "onebend-damp-1"
FREQUENCIES_FORMAT = "onebend-frequencies-1"


def summary_of(findings: Run) -> dict[str, Any]:
    """`learn --json` and `summary.json`."""
    learned, posterior, first = findings.learned, findings.posterior, findings.recordings[0]
    uncertain = None if posterior is None else posterior.stiffness
    return headed(LEARN_FORMAT) | {
        "recordings": [recording.source.name for recording in findings.recordings],
        "length_m": first.length,
        "method": "fit" if posterior is not None or learned is None else learned.method,
        "verdict": verdict_of(findings).as_dict(),
        "stiffness": stiffness_summary(findings.beam, uncertain, stated_section(findings.recordings)),
        "fit": None if posterior is None else _fit(posterior),
        "regression": None if learned is None else _regression(learned),
        "training": [comparison_summary(comparison) for comparison in findings.trainings],
        "validation": [comparison_summary(comparison) for comparison in findings.validations],
        "observed": [_observed(recording) for recording in findings.recordings],
        "remarks": [{"recording": whose, **remark.as_dict()} for whose, remark in all_remarks(findings)],
    }


def validation_summary(model: str, pairs: Sequence[tuple[Comparison, Observations]]) -> dict[str, Any]:
    """`validate --json`."""
    rows = []
    for comparison, recording in pairs:
        remarks = [remark.as_dict() for remark in pair_remarks(comparison, recording)]
        rows.append(comparison_summary(comparison) | {"remarks": remarks})
    verdict = validation_verdict([comparison for comparison, _ in pairs])
    return headed(VALIDATE_FORMAT, model=model, verdict=verdict, validation=rows)


def plan_summary(model: str, plan: Plan) -> dict[str, Any]:
    """`plan --json`, in SI."""
    return headed(PLAN_FORMAT, model=model) | {
        "before": vars(plan.before),
        "s": PLACES.tolist(),
        "sd_log_k": plan.sd.tolist(),
        "proposals": [_proposal(one) for one in plan.proposals],
        "pair": [_proposal(one) for one in plan.pair],
        "left_out": list(plan.left_out),
    }


def _proposal(one: Proposal) -> dict[str, Any]:
    return {
        "text": words(one.notice),
        "at_s": one.push.at_s,
        "direction_rad": one.push.direction,
        "largest_N": one.push.largest,
        "added_tag_s": one.added_tag,
        "better_sensor": one.better_sensor,
        "repeats": one.repeats,
        "tip_moves_m": one.tip_moves,
        "tip_turns_rad": one.tip_turns,
        "after": vars(one.after),
        "sd_log_k": one.sd.tolist(),
    }


def damp_summary(model: str, fit: SwingFit) -> dict[str, Any]:
    """`damp --json`."""
    return headed(DAMP_FORMAT, model=model) | {
        "damping": fit.damping.as_dict(),
        "k_over_mass": {"factor": fit.factor, "sd": fit.factor_sd, "model_sd": fit.model_sd}
        if fit.mass_known
        else None,
        "mass_kg": fit.mass,
        "mass_sd_kg": fit.mass_sd,
        "from_s": fit.swing.begin,
        "to_s": fit.swing.begin + float(fit.swing.time[-1]),
        "frames": len(fit.swing.time),
        "s": fit.swing.s,
        "rms_m": fit.rms,
        "remarks": [remark.as_dict() for remark in worded(fit.remarks)],
    }


def frequencies_summary(source: str, found: FoundFrequencies) -> dict[str, Any]:
    """`frequencies --json`."""
    names = {"frequency": "hz", "sd": "sd_hz", "multiple_of": "multiple_of_hz"}
    return headed(FREQUENCIES_FORMAT, source=source) | {
        "modes": [{names.get(name, name): value for name, value in asdict(one).items()} for one in found.modes],
        "from_s": found.begin,
        "to_s": found.end,
        "samples": found.samples,
        "samples_per_s": found.rate,
        "left": found.left,
        "remarks": [remark.as_dict() for remark in worded(found.remarks)],
    }


def comparison_summary(comparison: Comparison) -> dict[str, Any]:
    """One recording of Tables IV to VI."""
    return {
        "recording": comparison.name,
        "frames": len(comparison.frame),
        "tag": comparison.tag_id,
        "s": comparison.marker_s,
        "rms_m": comparison.rms,
        "sensor_rms_m": comparison.sensor_rms,
        "likely_rms_m": comparison.likely_rms,
        "all_stable": bool(np.all(comparison.stable)),
        "remarks": [remark.as_dict() for remark in worded(comparison.remarks)],
    }


_STATE_OF_SEARCH = ("part_variances", "chains")  # more than a thousand numbers in which nobody reads a size


def _fit(posterior: Posterior) -> dict[str, Any]:
    optimum, uncertain = posterior.optimum, posterior.stiffness
    sizes = asdict(optimum.hyperparameters)
    return {
        "trusted": not uncertain.doubts,
        "grade": posterior.grade,
        "secant_shares": posterior.secant_shares,
        "between_recordings": dict(zip(("sd", "low", "high"), posterior.mountings, strict=True)),
        "allowances": [asdict(share) | {"matters": share.matters} for share in posterior.attributions],
        "doubts": uncertain.doubts,
        "identified": identified_ranges(uncertain),
        "gain_sd": uncertain.gain_sd,
        "nuisances": [asdict(nuisance) for nuisance in posterior.nuisances()],
        "tradeoffs": [asdict(pair) for pair in tradeoffs(posterior)],
        "tradeoffs_with_level": [asdict(pair) for pair in with_level(posterior)],
        "hyperparameters": {name: one for name, one in sizes.items() if name not in _STATE_OF_SEARCH},
        "fitted_rms_m": list(fitted_rms(posterior)),
        "criticism": possible(posterior).criticism.as_dict() | {"trusted": posterior.criticism.trusted},
        "log_evidence": optimum.log_evidence,
        "steps": optimum.steps,
        "converged": optimum.converged,
        "stopped": optimum.stopped,
    }


def _regression(learned: Learned) -> dict[str, Any]:
    trial = learned.trials[learned.chosen]
    return {
        "method": learned.method,
        "family": learned.family,
        "chosen": {
            "n": trial.n,
            "m": trial.m,
            "coefficients_N_m": trial.coefficients,
            "rms_m": trial.rms,
            "bic": trial.bic,
            "lowest_k_N_m": trial.lowest_k,
            "condition": trial.condition,
            "why_out": trial.why_out,
        },
        "trials": len(learned.trials),
        "stiffness": stiffness_summary(learned.beam, None),
        "training": comparison_summary(learned.training),
    }


def _observed(observed: Observations) -> dict[str, Any]:
    clean, clock = observed.source.clean_force, observed.source.clock
    return {
        "recording": observed.source.name,
        "frames": {"all": len(observed.time), "loaded": int(observed.loaded.sum())},
        "force": None if clean is None else {
            "largest_N": float(np.max(np.linalg.norm(observed.force[observed.loaded], axis=1), initial=0.0)),
            "noise_sd_N": clean.noise_sd,
            "tare_N": clean.tare,
            "drift_N_s": clean.drift,
            "cutoff_Hz": clean.cutoff,
            "outliers": clean.outliers,
        },
        "clock": None if clock is None else {
            "offset_s": clock.offset, "sd_s": clock.sd, "stated_s": clock.stated, "found": clock.found
        },
    }  # fmt: skip
