"""What `onebend design` and `onebend mould` leave: the design along the beam as CSV, and a folder of parts to print."""

from __future__ import annotations

from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from onebend.files.manifest import write_summary
from onebend.lab.designs import Design
from onebend.lab.fabrication.mould import Mould, PrintedPart
from onebend.lab.fabrication.solids import write_mesh
from onebend.results.tables import PLACES, csv_rows

DESIGN_FORMAT = "onebend-design-1"
MOULD_FORMAT = "onebend-mould-1"
TAGS_FORMAT = "onebend-tags-1"
DESIGN_COLUMNS = ("s", "width_m", "EI_N_m2", "k_N_m", "mass_kg_m")


def design_csv(design: Design) -> str:
    """The design at 201 places."""
    s = np.linspace(0.0, 1.0, PLACES)
    columns = (s, design.width(s), design.bending(s), design.along.stiffness(s), design.along.mass_per_length(s))
    text = StringIO(newline="")
    csv_rows(text, DESIGN_COLUMNS, ([f"{value:.9g}" for value in row] for row in zip(*columns, strict=True)))
    return text.getvalue()


def parts_summary(made: Mould, parts: tuple[PrintedPart, ...], *, written_by: str) -> dict[str, Any]:
    """What `onebend mould --json` prints and `summary.json` holds (there with `files`)."""
    return {
        "format": MOULD_FORMAT,
        "written_by": written_by,
        "design": made.design.name,
        "kind": made.settings.kind,
        "pour_m3": made.volume,
        "pour_kg": made.pour,
        "parts": {part.name: {"size_mm": part.mesh.extents.tolist(), "volume_mm3": part.mesh.volume} for part in parts},
    }


def parts_writer(parts: tuple[PrintedPart, ...], shape: str, summary: dict[str, Any]) -> Callable[[Path], None]:
    """What `publish` needs to fill a folder with parts as files of the ending `shape`."""

    def write(folder: Path) -> None:
        for part in parts:
            write_mesh(folder / f"{part.name}.{shape}", part.mesh)
        write_summary(folder, summary)

    return write
