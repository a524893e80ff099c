"""What recording.toml says of the cross-section: read, joined with its table, refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from onebend.errors import RecordingError
from onebend.recording.folder import read_recording
from onebend.recording.stated import stated_in
from onebend.records import Stated
from tests.recording.toml.test_folder_entries import FULL, folder_with


def stated(folder: Path, entries: str, table: str = "") -> Stated:
    """What a recording with these lines in [beam] and this section.csv states."""
    made = folder_with(folder, FULL.replace("mass_kg = 0.08\n", f"mass_kg = 0.08\n{entries}\n"))
    (made / "section.csv").write_text(table, encoding="utf-8")
    return stated_in(read_recording(made))


def test_a_constant_rectangle(tmp_path: Path) -> None:
    found = stated(tmp_path, "width_m = 0.012\nthickness_m = 0.03\nsection_sd_m = 0.0001")
    section = found.section
    assert section is not None
    assert (section.shape, section.sd, found.thickness) == ("rectangle", 0.0001, 0.012)
    assert section.s.tolist() == [0.0, 1.0]
    assert section.thickness.tolist() == [0.012, 0.012]  # in the plane of bending: the width of recording.toml
    assert section.width.tolist() == [0.03, 0.03]


def test_half_of_a_section_is_none(tmp_path: Path) -> None:
    width, thickness = stated(tmp_path / "a", "width_m = 0.012"), stated(tmp_path / "b", "thickness_m = 0.03")
    assert width.section is None
    assert width.thickness == 0.012
    assert thickness.section is None
    assert math.isnan(thickness.thickness)
    assert math.isnan(stated(tmp_path / "c", "").thickness)


def test_a_round_beam_stretches_as_a_rectangle_of_its_area_and_second_moment(tmp_path: Path) -> None:
    found = stated(tmp_path, "diameter_m = 0.01")
    assert found.section is not None
    assert found.section.shape == "circle"
    assert math.isnan(found.section.sd)
    area, second = math.pi * 0.01**2 / 4, math.pi * 0.01**4 / 64
    assert 12.0 / found.thickness**2 == pytest.approx(area / second)


def test_a_table_and_a_constant_make_one_section(tmp_path: Path) -> None:
    rows = "s,width_m\n0,0.008\n0.5,0.012\n1,0.010\n"
    found = stated(tmp_path, 'section_file = "section.csv"\nthickness_m = 0.03', rows)
    assert found.section is not None
    np.testing.assert_array_equal(found.section.s, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(found.section.thickness, [0.008, 0.012, 0.010])
    np.testing.assert_array_equal(found.section.width, [0.03, 0.03, 0.03])
    assert found.thickness == pytest.approx(0.0105)  # mean along the beam


def test_a_table_may_hold_all(tmp_path: Path) -> None:
    found = stated(tmp_path, 'section_file = "section.csv"', "s,diameter_m\n0.1,0.008\n0.9,0.004\n")
    assert found.section is not None
    np.testing.assert_array_equal(found.section.s, [0.1, 0.9])
    np.testing.assert_array_equal(found.section.thickness, [0.008, 0.004])


def test_a_tube_a_hexagon_and_a_second_moment(tmp_path: Path) -> None:
    tube = stated(tmp_path / "a", f"{FILE}\ndiameter_m = 0.012", "s,inner_diameter_m\n0,0.010\n1,0.008\n")
    assert tube.section is not None
    assert tube.section.shape == "tube"
    assert tube.section.inner is not None
    assert tube.section.inner.tolist() == [0.010, 0.008]
    assert tube.section.thickness.tolist() == [0.012, 0.012]
    hexagon = stated(tmp_path / "b", "across_flats_m = 0.006\nsection_sd_m = 0.0001")
    assert hexagon.section is not None
    assert (hexagon.section.shape, hexagon.section.sd) == ("hexagon", 0.0001)
    area, second = math.sqrt(0.75) * 0.006**2, 5.0 * math.sqrt(3.0) / 144.0 * 0.006**4
    assert 12.0 / hexagon.thickness**2 == pytest.approx(area / second)
    by_moment = stated(tmp_path / "c", f"{FILE}\nI_sd = 0.05", "s,I_m4\n0,1e-10\n1,2e-11\n").section
    assert by_moment is not None
    assert by_moment.moment is not None
    assert (by_moment.shape, by_moment.moment_sd) == ("second moment", 0.05)
    assert by_moment.moment.tolist() == [1e-10, 2e-11]


def test_a_place_that_stands_twice_is_a_step(tmp_path: Path) -> None:
    found = stated(tmp_path, FILE, "s,diameter_m\n0,0.01\n0.5,0.01\n0.5,0.006\n1,0.006\n").section
    assert found is not None
    assert found.s.tolist() == [0.0, 0.5, 0.5, 1.0]


def test_k_may_be_stated_to_go_with_the_section(tmp_path: Path) -> None:
    found = stated(tmp_path, 'stiffness_along = "section"\ndiameter_m = 0.01\nmodulus_varies = 0.1')
    assert (found.stiffness_along, found.modulus_varies) == ("section", 0.1)


def test_the_mass_may_go_with_the_sections_area(tmp_path: Path) -> None:
    rows = "s,diameter_m,inner_diameter_m\n0,0.010,0.008\n0.4,0.010,0.004\n0.4,0.006,0.004\n0.9,0.006,0.005\n"
    found = stated(tmp_path, f'{FILE}\nmass_along = "section"', rows)
    line = found.mass_line
    assert line is not None
    assert found.mass == 0.08
    s = np.array([0.0, 0.2, 0.65, 0.9])
    area = np.array([0.010, 0.010, 0.006, 0.006]) ** 2 - np.array([0.008, 0.006, 0.0045, 0.005]) ** 2
    per_metre = np.interp(s, line.s, line.value)
    np.testing.assert_allclose(per_metre / per_metre[0], area / area[0], rtol=1e-9)
    length = read_recording(tmp_path).beam.length
    whole = float(np.trapezoid(line.value, line.s) + 0.1 * line.value[-1])  # beyond 0.9 it stays as it is there
    assert length * whole == pytest.approx(0.08, rel=1e-12)


FILE = 'section_file = "section.csv"'
WITH = f'{FILE}\nstiffness_along = "section"'
REFUSED = {
    "both shapes": ("diameter_m = 0.01\nwidth_m = 0.01", "", "Give one of these, not several"),
    "twice": (f"{FILE}\nwidth_m = 0.01", "s,width_m,thickness_m\n0,0.1,0.1\n1,0.1,0.1\n", "width_m stands in [beam]"),
    "not whole": (FILE, "s,width_m\n0,0.01\n1,0.01\n", "thickness_m is missing"),
    "no size": (f"{FILE}\nwidth_m = 0.01\nthickness_m = 0.01", "s,note\n0,a\n1,b\n", "there is no column width_m"),
    "another unit": (FILE, "s,width_mm,thickness_m\n0,9,0.01\n1,9,0.01\n", "did you mean width_m?"),
    "no area": (f'{FILE}\nmass_along = "section"', "s,I_m4\n0,1e-9\n1,1e-9\n", "needs the section's sizes"),
    "mass twice": (
        'diameter_m = 0.01\nmass_along = "section"\nmass_file = "section.csv"',
        "s,kg_per_m\n0,1\n1,1\n",
        "both say how the mass is spread",
    ),
    "three shapes": ("diameter_m = 0.01\nacross_flats_m = 0.01\nwidth_m = 0.01", "", "Give one of these, not several"),
    "no outside": ("inner_diameter_m = 0.01", "", "inner_diameter_m is of a tube. Give its diameter_m too"),
    "no wall": ("diameter_m = 0.01\ninner_diameter_m = 0.01", "", "inner_diameter_m must be less than diameter_m"),
    "no wall, by row": (
        f"{FILE}\ndiameter_m = 0.01",
        "s,inner_diameter_m\n0,0.009\n1,0.011\n",
        "section.csv, line 3: inner_diameter_m must be less than diameter_m",
    ),
    "moment and size": (f"{FILE}\nwidth_m = 0.01", "s,I_m4\n0,1e-9\n1,1e-9\n", "Give one of these, not several"),
    "moment of zero": (FILE, "s,I_m4\n0,1e-9\n1,0\n", "line 3: I_m4 must be above zero, and in m^4"),
    "a spike": (FILE, "s,diameter_m\n0,0.01\n0.5,6\n1,0.01\n", "line 3: the beam is thicker than long there"),
    "moment of a thick beam": (FILE, "s,I_m4\n0,1e-9\n1,0.01\n", "line 3: the beam is thicker than long there"),
    "sd of sizes": (f"{FILE}\nsection_sd_m = 1e-4", "s,I_m4\n0,1e-9\n1,1e-9\n", "Of I_m4, give I_sd"),
    "sd of moments": ("diameter_m = 0.01\nI_sd = 0.1", "", "Of sizes, give section_sd_m"),
    "no section": ('stiffness_along = "section"\nwidth_m = 0.01', "", 'stiffness_along = "section" needs the section'),
    "not to the ends": (WITH, "s,diameter_m\n0.2,0.01\n1,0.01\n", "known from s = 0.2 to 1 only"),
    "nothing to vary about": (
        "diameter_m = 0.01\nmodulus_varies = 0.1",
        "",
        "modulus_varies goes with stiffness_along",
    ),
    "step at an end": (FILE, "s,diameter_m\n0,0.01\n0,0.02\n1,0.01\n", "line 3: s must rise"),
    "three at one place": (
        FILE,
        "s,diameter_m\n0,0.01\n0.5,0.02\n0.5,0.01\n0.5,0.03\n1,0.01\n",
        "line 5: s must rise",
    ),
    "one place": (FILE, "s,diameter_m\n0.5,0.01\n", "one place is no profile. Give the sizes in [beam]"),
    "falls": (FILE, "s,diameter_m\n0.5,0.01\n0.2,0.01\n", "line 3: s must rise"),
    "outside": (FILE, "s,diameter_m\n0.5,0.01\n1.2,0.01\n", "line 3: s must be between 0"),
    "zero": (FILE, "s,diameter_m\n0.5,0.01\n0.7,0\n", "line 3: diameter_m must be above zero"),
    "empty": (FILE, "s,diameter_m\n0.5,\n0.7,0.1\n", "line 2: diameter_m must be above zero"),
    "no number": (FILE, "s,diameter_m\n0.5,wide\n0.7,0.1\n", "line 2: diameter_m is 'wide'"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_section_is_refused(tmp_path: Path, case: str) -> None:
    entries, table, words = REFUSED[case]
    with pytest.raises(RecordingError) as told:
        stated(tmp_path, entries, table)
    assert words in str(told.value)


def test_a_section_larger_than_the_beam_is_warned_of(tmp_path: Path) -> None:
    content = FULL.replace("mass_kg = 0.08\n", "mass_kg = 0.08\nwidth_m = 12\nthickness_m = 0.03\n")
    warnings = [r.text for r in read_recording(folder_with(tmp_path, content)).remarks if r.level == "warning"]
    assert [text for text in warnings if "width_m = 12 is a section larger than the beam is long" in text]
    assert not [text for text in warnings if "thickness_m" in text]


@pytest.mark.parametrize(("width", "thickness", "asked"), [(0.03, 0.012, 1), (0.012, 0.03, 0), (0.01, 0.01, 0)])
def test_sizes_that_look_swapped_are_asked_after(tmp_path: Path, width: float, thickness: float, asked: int) -> None:
    content = FULL.replace("mass_kg = 0.08\n", f"mass_kg = 0.08\nwidth_m = {width}\nthickness_m = {thickness}\n")
    notes = [r for r in read_recording(folder_with(tmp_path, content)).remarks if "swapped" in r.text]
    assert [note.level for note in notes] == asked * ["note"]


@pytest.mark.parametrize(
    "entries",
    ["width_m = 0.0012\nthickness_m = 0.00003", "diameter_m = 0.00005", "width_m = 1.2\nthickness_m = 3"],
)
def test_a_beam_of_no_material_is_refused(tmp_path: Path, entries: str) -> None:
    with pytest.raises(RecordingError, match=r"as no material is\. Check mass_kg"):
        stated(tmp_path, entries)
