"""A local page for one person."""

from __future__ import annotations

from onebend.wings import Place

COMMANDS = {
    "studio": Place(
        "onebend.studio.commands:studio",
        "Open a local page to record, learn, view results, bend learned beams and simulate loops.",
        "out",
    )
}
