"""Many recordings: learning one by one on all cores, and statistics of groups of objects."""

from __future__ import annotations

from onebend.wings import Place

COMMANDS = {
    "batch": Place(
        "onebend.many.commands:batch",
        "Learn k(s) of each of many recordings, on all cores; an interrupted run continues.",
        "out/stems -o out/stems-learned",
        "onebend film linear --markers -o out/stems/dry/stem-1",
        group="Many",
    ),
    "population": Place(
        "onebend.many.commands:population",
        "Compare groups of objects in a batch: mean k(s), spread, outliers.",
        "out/pushes-learned --by group -o out/population",
        "onebend batch examples/linear-beam -o out/pushes-learned",
        group="Many",
    ),
}
