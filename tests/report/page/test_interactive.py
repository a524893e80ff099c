"""The page's own script: the numbers it is given, its solver of the beam against ours, what it does in a browser."""

from __future__ import annotations

import base64
import hashlib
import html as markup
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, Uniform
from onebend.records import PointMass
from onebend.report.page import COMMON, PLACES, SCRIPTS, page, page_file, script_data
from onebend.report.sentences import highest_shown
from tests import made_up
from tests.report.page.browser import after_script, node_output, title_of

S = np.linspace(0.0, 1.0, PLACES)
PUSHES = [((0.1, 0.3), 1.0), ((-0.3, 0.8), 0.63), ((0.0, -2.0), 1.0), ((0.0, 0.0), 0.5), ((3.0, 5.0), 0.8)]


def data_of(found: Any) -> dict[str, Any]:
    data = json.loads(script_data(found))
    assert isinstance(data, dict)
    return data


def test_the_script_is_given_the_curve_of_the_records() -> None:
    found = made_up.findings(0)
    assert found.posterior is not None
    data = data_of(found)["curve"]
    np.testing.assert_allclose(data["k_N_m"], found.beam.stiffness(S), rtol=1e-5)
    for band in data["bands"]:
        ours = found.posterior.band(S, band["level"])
        np.testing.assert_allclose(band["low_N_m"], ours.low, rtol=1e-5)
        np.testing.assert_allclose(band["high_N_m"], ours.high, rtol=1e-5)
    assert [band["level"] for band in data["bands"]] == [0.95, 0.8, 0.5]
    assert data["known"] == found.posterior.band(S).identified.tolist()
    assert data["top_N_m"] == highest_shown(found.posterior.stiffness)
    assert data["tag_words"] == ["tag 1", "2", "3"]
    assert data["tag_s"] == pytest.approx(found.trainings[0].marker_s, rel=1e-5)


def test_without_a_fit_there_is_no_band_and_without_a_beam_nothing_bends() -> None:
    found = made_up.findings(0, fitted=False)
    assert data_of(found)["curve"]["bands"] == []
    assert data_of(replace(found, beam=Beam(0.15, Powers((0.1, -0.2)))))["bend"] is None


def test_the_beam_to_bend_has_the_weight_and_the_force_of_the_recording() -> None:
    found = made_up.findings(0)
    data = data_of(found)["bend"]
    sizes = np.linalg.norm(found.trainings[0].force, axis=1)
    assert data["largest_N"] == pytest.approx(float(sizes.max()))
    assert data["gravity_m_s2"] == [0.0, 0.0]
    heavy = replace(found.recordings[0], gravity=found.recordings[0].gravity + np.array([0.0, -9.81]))
    weighed = replace(found, beam=replace(found.beam, mass_per_length=Uniform(0.2)), recordings=(heavy,))
    data = data_of(weighed)["bend"]
    assert data["gravity_m_s2"] == pytest.approx([0.0, -9.81])
    assert data["mass_kg_m"] == [0.2] * PLACES
    still = replace(found, trainings=tuple(replace(one, force=0.0 * one.force) for one in found.trainings))
    data = data_of(still)["bend"]
    assert data["largest_N"] == 0.0
    tip = found.beam.equilibrium((0.0, data["force_N"])).xy(1.0)[1] / found.beam.length
    assert 0.1 < tip < 0.8  # it bends well, and does not fold


def test_no_data_can_end_the_script_element() -> None:
    text = str(script_data(made_up.findings(0)))
    assert not set("<>&") & set(text)
    assert text.isascii()


def test_the_page_allows_its_own_script_alone() -> None:
    html = page(made_up.findings(0), {})
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', html)
    script = re.search(r"<script>(.*?)</script>", html, re.DOTALL)
    assert policy is not None
    assert script is not None
    digest = base64.b64encode(hashlib.sha256(script[1].encode()).digest()).decode()
    rules = markup.unescape(policy[1])
    assert f"script-src 'sha256-{digest}'" in rules
    assert rules.startswith("default-src 'none'")
    assert script[1].count("fetch(") == script[1].count("XMLHttpRequest") == script[1].count("innerHTML") == 0


def test_the_solver_of_the_page_agrees_with_ours(tmp_path: Path) -> None:
    """To 1e-4 of the length at all places, with weight, a mass that rides on it, a rest shape and a turned clamp."""
    beam = Beam(
        made_up.LENGTH, made_up.GAUSSIANS, rest_curvature=Uniform(0.3), mass_per_length=Uniform(0.1), clamp_angle=0.1,
        masses=(PointMass(0.6, 0.02),),
    )  # fmt: skip
    data = {
        "length_m": beam.length, "clamp_rad": 0.1, "k_N_m": beam.stiffness(S).tolist(), "q0_rad": [0.3] * PLACES,
        "mass_kg_m": [0.1] * PLACES, "masses": [[0.6, 0.02]], "gravity_m_s2": [-3.0, -9.0],
    }  # fmt: skip
    places = [0.2, 0.5, 0.83, 1.0]
    asked = (
        f"const made = madeOf({json.dumps(data)}), out = {json.dumps(PUSHES)}.map(([force, at]) => {{"
        f"const a = equilibrium(made, force, at, null); return {places}.map((s) => placeOf(made, a, s)); }});"
        "const pulled = pulledTo(made, [0.1, 0.08], 0.7, 10, 5, [0, 0], null);"
        "console.log(JSON.stringify([out, pulled.force, placeOf(made, pulled.a, 0.7)]));"
    )
    shapes, force, pulled = json.loads(node_output(page_file(COMMON, "beam.js") + asked, tmp_path))
    for (push, at), xy in zip(PUSHES, shapes, strict=True):
        ours = beam.equilibrium(push, at, gravity=(-3.0, -9.0)).xy(places)
        np.testing.assert_allclose(xy, ours, atol=1e-4 * beam.length)
    np.testing.assert_allclose(force, 10.0 * (np.array([0.1, 0.08]) - pulled), atol=1e-3)
    np.testing.assert_allclose(pulled, beam.equilibrium(force, 0.7, gravity=(-3.0, -9.0)).xy(0.7), atol=1e-5)


MOVES = """
Element.prototype.setPointerCapture = () => {};
const part = (id, name) => document.querySelector(`#${id} ${name}`);
const said = [], curve = part("curve", ".chart"), bend = part("bend", ".chart");
const send = (node, kind, clientX, clientY) =>
  node.dispatchEvent(new PointerEvent(kind, { clientX, clientY, bubbles: true }));
const key = (node, name) => node.dispatchEvent(new KeyboardEvent("keydown", { key: name, bubbles: true }));
const read = (id) => said.push(part(id, ".readout").textContent);
const box = curve.getBoundingClientRect();
send(curve, "pointerdown", box.left + 52 + 0.25 * (box.width - 66), box.top + 50); read("curve");
key(curve, "ArrowRight"); read("curve");
key(curve, "End"); read("curve");
const handle = part("bend", ".handle"), place = handle.getBoundingClientRect();
send(handle, "pointerdown", place.left + 20, place.top + 20);
send(bend, "pointermove", place.left + 5, place.top + 60); send(bend, "pointerup", 0, 0); read("bend");
send(bend, "pointermove", 0, 0); read("bend");
key(bend, "Escape"); read("bend");
said.push(document.querySelector("[data-instead=curve]").hidden, getComputedStyle(curve).touchAction);
const log = part("curve", "input");
log.checked = true; log.dispatchEvent(new Event("change"));
said.push(/NaN|Infinity/.test(curve.innerHTML));
const sizes = [...document.querySelectorAll(".chart > svg")].map((one) => one.getBoundingClientRect().width);
said.push(Math.max(...sizes), document.querySelectorAll("#curve svg path").length);
document.title = JSON.stringify(said);
"""


@pytest.mark.slow
def test_the_curve_is_read_by_touch_and_keys_and_the_beam_is_dragged(tmp_path: Path) -> None:
    found = made_up.findings(0)
    assert found.posterior is not None
    html = page(found, {"stiffness": b"png"}).replace("<main>", '<main style="width: 390px">')
    title = after_script(html, MOVES, tmp_path)
    touched, moved, end, dragged, released, free, hidden, touch, lost, width, paths = json.loads(markup.unescape(title))
    assert touched.startswith("s = 0.25 · 37.5 mm from the clamp · k = ")
    band = found.posterior.band(np.array([0.25]))
    assert f"k = {float(band.k[0]):#.3g} N m · 95 % band {float(band.low[0]):#.3g} to" in touched
    assert moved.startswith("s = 0.26")
    assert end.startswith("s = 1.00")
    force = np.array([float(one) for one in re.findall(r"F = \((.*), (.*)\) N,", dragged)[0]])
    tip = np.array([float(one) for one in re.findall(r"tip at \((.*), (.*)\) mm", dragged)[0]])
    assert np.linalg.norm(force) > 0.01
    np.testing.assert_allclose(1e-3 * tip, found.beam.equilibrium(force).xy(1.0), atol=1e-3 * found.beam.length)
    assert released == dragged
    assert free.startswith("F = (0, 0) N")
    assert hidden
    assert touch == "pan-y"  # a finger scrolls the page up and down, and reads the curve from left to right
    assert not lost  # nothing of the logarithmic curve
    assert width <= 390.0
    assert paths >= 4


@pytest.mark.slow
def test_a_script_from_elsewhere_does_not_run(tmp_path: Path) -> None:
    html = page(made_up.findings(0), {})
    evil = "<script>document.title = 'taken'</script>"
    assert title_of(
        html.replace("</body>", f"{evil}<img src=x onerror=\"document.title='taken'\"></body>"), tmp_path
    ) == ("k(s) of made-up")
    assert after_script(html, "document.title = 'run'", tmp_path) == "run"  # so it would have


def test_the_scripts_are_small() -> None:
    assert sum(len(page_file(COMMON, name)) for name in SCRIPTS) < 30_000


@pytest.mark.slow
def test_the_table_of_k_fits_a_phone(tmp_path: Path) -> None:
    script = """const table = document.querySelector("table.k");
document.title = [table.rows.length, table.scrollWidth <= table.parentElement.clientWidth].join(" ");"""
    html = page(made_up.findings(0), {}).replace("<main>", '<main style="width: 390px">')
    assert after_script(html, script, tmp_path, width=390) == "12 true"  # headless windows are 500 px or wider
