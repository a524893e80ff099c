"""Design a beam with a soft middle, say what it will do, and write its tags to print.

python examples/make_a_beam.py [FOLDER]
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

from onebend.lab import Design, Expected, Sheet, expect, silicone, tag_pages, width_table, write_pages


def main(folder: Path) -> Expected:
    product = silicone("Dragon Skin 20")
    design = Design(
        name="soft-middle",
        length=0.16,
        depth=0.025,
        width=width_table((0.0, 0.4, 0.55, 0.7, 1.0), (0.016, 0.014, 0.009, 0.014, 0.016)),
        modulus=product.stiffness.modulus,
        modulus_log_sd=product.stiffness.log_sd,
        density=product.density,
        source=product.stiffness.source,
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
