"""Many beams: recordings learned one by one on all cores, and what they say of the populations they are from."""

from __future__ import annotations

from onebend.wings import Place

COMMANDS = {
    "batch": Place(
        "onebend.many.commands:batch",
        "Learn k(s) of thousands of recordings, each by itself, on all cores or a cluster; go on where it was stopped.",
        "out/stems -o out/stems-learned",
        "onebend film linear --markers -o out/stems/dry/stem-1",
    ),
    "population": Place(
        "onebend.many.commands:population",
        "Say what a batch tells of the populations its objects are from: mean k(s) of groups, spread, outliers.",
        "out/pushes-learned --by group -o out/population",
        "onebend batch examples/linear-beam -o out/pushes-learned",
    ),
}
