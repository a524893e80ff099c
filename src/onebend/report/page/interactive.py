"""What the page's own script draws: k(s) with its bands to touch, and the learned beam to bend. Numbers alone."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from markupsafe import Markup

from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.records import Array, Observations
from onebend.report.figures.bands import LEVELS, highest_shown
from onebend.report.figures.film import FilmStrip
from onebend.report.findings import Findings
from onebend.strict_json import to_json

SCRIPTS = ("beam.js", "curve.js", "bend.js", "film.js", "page.js")  # in this order, one script
PLACES = 201  # of the curves, s = 0, 0.005, ..., 1
_DIGITS = 6


def script_data(findings: Findings, film: FilmStrip | None = None) -> Markup:
    """JSON for a script element, with nothing in it that could end the element."""
    data = {"curve": _curve(findings), "bend": _bend(findings), "film": None if film is None else _film(film)}
    text = to_json(data, ascii_only=True, readable=False)
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


def _curve(findings: Findings) -> dict[str, Any]:
    """k(s) with its bands, in N m."""
    s = np.linspace(0.0, 1.0, PLACES)
    beam, posterior, learned = findings.beam, findings.posterior, findings.learned
    k = np.asarray(beam.stiffness(s))
    found: dict[str, Any] = {
        "length_m": beam.length,
        "tag_id": findings.trainings[0].tag_id.tolist(),
        "tag_s": _short(findings.trainings[0].marker_s),
        "k_N_m": _short(k),
        "bands": [],
        "top_N_m": float(max(np.max(k), 0.0)),
        "lowest_N_m": float(min(np.min(k), 0.0)),
    }
    if posterior is None:
        return found
    uncertain = posterior.stiffness
    found |= {"known": uncertain.band(s).identified.tolist(), "top_N_m": highest_shown(uncertain)}
    found |= {"bands": _bands(uncertain, s), "unknown": "not to be trusted" if uncertain.doubts else "not identified"}
    if learned is not None:
        found["regression_N_m"] = _short(np.asarray(learned.beam.stiffness(s)))
    return found


def _bands(uncertain: UncertainStiffness, s: Array) -> list[dict[str, Any]]:
    bands = [(level, strength, uncertain.band(s, level)) for level, strength in LEVELS]
    return [
        {"level": level, "strength": strength, "low_N_m": _short(band.low), "high_N_m": _short(band.high)}
        for level, strength, band in bands
    ]


def _bend(findings: Findings) -> dict[str, Any] | None:
    """The beam and how hard it was loaded; None where there is no beam to bend, or nothing is known of the load."""
    beam, s = findings.beam, np.linspace(0.0, 1.0, PLACES)
    k, first = np.asarray(beam.stiffness(s)), findings.recordings[0]
    if np.min(k) <= 0.0:
        return None
    forces = np.nan_to_num(np.concatenate([one.force for one in findings.trainings]))
    hardest = forces[np.argmax(np.linalg.norm(forces, axis=1))]
    largest = float(np.linalg.norm(hardest))
    gravity = _gravity(first)
    mass = np.asarray(beam.mass_per_length(s))
    # without a load of its own: what turns the tip by about half a radian
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
    """The frames as data URIs, and what is drawn over them, in their pixels."""
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


def _gravity(observations: Observations) -> Array:
    """(2,) m/s^2 in the plane of bending, the mean over the recording."""
    return np.asarray(np.nan_to_num(np.mean(observations.gravity, axis=0)))


def _short(values: Array) -> list[float]:
    """To six digits: the page need not carry the rest."""
    return [float(f"{value:.{_DIGITS}g}") for value in values]
