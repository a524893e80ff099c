"""Design a beam with a soft middle, say what it will do, and write its tags to print.

python examples/make_a_beam.py [FOLDER]
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

from onebend.lab import Design, Expected, Sheet, expect, from_shore_a, tag_pages, width_table, write_pages


def main(folder: Path) -> Expected:
    silicone = from_shore_a(20.0)
    design = Design(
        name="soft-middle",
        length=0.16,
        depth=0.025,
        width=width_table((0.0, 0.4, 0.55, 0.7, 1.0), (0.016, 0.014, 0.009, 0.014, 0.016)),
        modulus=silicone.modulus,
        modulus_log_sd=silicone.log_sd,
        density=1080.0,
        source=silicone.source,
    )
    expected = expect(design)
    for one in expected.bends:
        print(f"{math.degrees(one.turn):.0f} degrees: {one.force:.3f} N, strain {100 * one.strain:.0f} %")

    folder.mkdir(parents=True, exist_ok=True)
    write_pages(folder / "tags.pdf", tag_pages(Sheet(ids=(0, 1, 2, 3), size=0.012)), "tags of the soft beam")
    print(f"The beam weighs {1e3 * design.mass:.0f} g. Its tags are in {folder}.")
    return expected


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "soft-middle"))
