"""Sheets of tags to print, measured in their PDF."""

from __future__ import annotations

import numpy as np
import pypdfium2
from pyapriltags import Detector

from onebend.lab.sheet import PAGES, Sheet, files_of, tag_pages

DPI = 600


def sheet_row(page: str, size: float, family: str) -> str:
    """One sheet: corners found in the rendered PDF, outlines of its paths, against where they should be."""
    ids = tuple(range(12))
    (made,) = tag_pages(Sheet(ids, size, family, page=page))
    (content,) = files_of("t.pdf", [made], "t").values()
    document = pypdfium2.PdfDocument(content)
    image = np.ascontiguousarray(document[0].render(scale=DPI / 72, grayscale=True).to_numpy())
    boxes = [obj.get_bounds() for obj in document[0].get_objects()]
    document.close()
    detector = Detector(families=family, nthreads=1, quad_decimate=1.0)
    found = {one.tag_id: np.asarray(one.corners) * 25.4 / DPI for one in detector.detect(image)}
    corner_off, path_off = 0.0, 0.0
    height = made.axes[0].get_ylim()[0]
    for tag, fill in zip(ids, made.axes[0].patches, strict=True):
        low, high = fill.get_path().get_extents().get_points()
        wanted = [[low[0], high[1]], [high[0], high[1]], [high[0], low[1]], [low[0], low[1]]]
        corner_off = max(corner_off, float(np.max(np.abs(found[tag] - wanted))))
        bounds = np.array([low[0], height - high[1], high[0], height - low[1]])
        path_off = max(path_off, min(float(np.max(np.abs(np.array(box) * 25.4 / 72 - bounds))) for box in boxes))
    return f"| {page} | {family} | {1e3 * size:g} | {len(found)} of {len(ids)} | {path_off:.4f} | {corner_off:.4f} |"


def main() -> None:
    print(f"Sheets, from their PDF; asked: <= 0.05 mm. Corners are the detector's, in the page at {DPI} dpi.\n")
    print("| page | family | size [mm] | found, upright | outlines off [mm] | detected corners off [mm] |")
    print("| --- | --- | --- | --- | --- | --- |")
    for page in PAGES:
        for family, size in (("tag36h11", 0.012), ("tag36h11", 0.03), ("tag25h9", 0.012), ("tag16h5", 0.02)):
            print(sheet_row(page, size, family))


if __name__ == "__main__":
    main()
