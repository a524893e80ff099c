"""The place of the push, as the films show it: the tool seen, and a wrong `at_s` accused.

Each film is read as `learn` reads it, then with `at_s` written otherwise; `check` sees some twenty frames alone. An
accusation of what is right would be a fault of the program; a wrong place that is let pass is one that it cannot see.
Other films: `--recordings DIR`, a folder of recordings with their truth.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.truth import recordings_asked
from onebend.recording.entries import Recording
from onebend.recording.folder import FILE_NAME, read_recording
from onebend.recording.observe import observe
from onebend.recording.preview import look_at
from onebend.recording.tags import detect_tags
from onebend.recording.tool import ToolPlace, tool_in_film, tool_remarks
from onebend.recording.video import spacing_of
from onebend.records import Markers, Observations

OFF = (0.05, 0.1, 0.2)  # of the length, by which a place is written wrong
FOLDERS = ("", "wild")


@dataclass(frozen=True)
class Row:
    """One film."""

    name: str
    at: float  # where it was pushed
    recording: Recording
    by_film: ToolPlace
    by_check: ToolPlace
    seconds: float  # of one core, for the search in the film

    def accused(self, tool: ToolPlace, said: float) -> bool:
        """Whether this place, written down, is warned of."""
        assert self.recording.push is not None
        wrong = replace(self.recording, push=replace(self.recording.push, at=said))
        return bool(tool_remarks(tool, wrong))


def markers_of(seen: Observations) -> Markers:
    """The tags as they were read."""
    still = np.zeros(len(seen.time))
    return Markers(
        seen.time, seen.tag_id, seen.marker_s, seen.xy, seen.angle, seen.covariance, still, seen.source.view
    )  # fmt: skip


def row_of(folder: Path) -> Row | None:
    """What one film shows; None where it is no film of a push at a place that is written down."""
    rec = read_recording(folder)
    if rec.video is None or rec.push is None or not np.isfinite(rec.push.at) or rec.force is None:
        return None
    tags = detect_tags(rec.video, rec.tags)
    seen, every = observe(rec, detections=tags), spacing_of(len(tags.time), tags.width * tags.height)
    began = time.process_time()
    by_film = tool_in_film(rec, markers_of(seen), seen.loaded, seen.frame, every=every)
    seconds = time.process_time() - began
    at = float(json.loads((folder / "truth" / "truth.json").read_text(encoding="utf-8"))["s_a"])
    return Row(folder.name, at, rec, by_film, look_at(rec).tool, seconds)


def rows_of(recordings: Path) -> list[Row]:
    """All films of the folder."""
    folders = [
        path for part in FOLDERS for path in sorted((recordings / part).glob("*")) if (path / FILE_NAME).exists()
    ]
    return [row for row in map(row_of, folders) if row is not None]


def wrongly_said(at: float, off: float) -> list[float]:
    """The places so far off the true one, on the beam."""
    return [said for said in (at - off, at + off) if 0.0 < said <= 1.0 + 1e-9]


def place(tool: ToolPlace) -> str:
    return f"{tool.s:.3f} +- {tool.sd:.3f}" if tool.seen else "not seen"


def table(rows: Sequence[Row]) -> list[str]:
    """Film by film."""
    heads = " | ".join(f"{off:g} off" for off in OFF)
    lines = [
        f"| film | pushed at | seen | off [mm] | off [sd] | by `check` | said rightly | {heads} | search [s] |",
        "| --- " * (8 + len(OFF)) + "|",
    ]
    for row in rows:
        tool, length = row.by_film, row.recording.beam.length
        verdicts = []
        for off in OFF:
            said = [row.accused(tool, one) for one in wrongly_said(row.at, off)]
            verdicts.append(f"{sum(said)} of {len(said)} accused" if tool.seen else "-")
        right = "ACCUSED" if row.accused(tool, row.at) or row.accused(row.by_check, row.at) else "let pass"
        away = f"{1e3 * length * (tool.s - row.at):.1f} | {(tool.s - row.at) / tool.sd:.1f}" if tool.seen else "- | -"
        lines.append(
            f"| {row.name} | {row.at:g} | {place(tool)} | {away} | {place(row.by_check)} | {right} | "
            f"{' | '.join(verdicts)} | {row.seconds:.2f} |"
        )
    return lines


def summary(rows: Sequence[Row]) -> list[str]:
    """All films together, as `learn` and as `check` see them."""
    heads = " | ".join(f"{off:g} off" for off in OFF)
    lines = [f"| | seen | right places accused | {heads} |", "| --- " * (3 + len(OFF)) + "|"]
    for name in ("by_film", "by_check"):
        tools = [getattr(row, name) for row in rows]
        found = [str(sum(tool.seen for tool in tools)) + f" of {len(rows)}"]
        found.append(str(sum(row.accused(tool, row.at) for row, tool in zip(rows, tools, strict=True))))
        for off in OFF:
            said = [
                row.accused(tool, one)
                for row, tool in zip(rows, tools, strict=True)
                for one in wrongly_said(row.at, off)
            ]
            found.append(f"{sum(said)} of {len(said)} accused")
        lines.append(f"| {'`learn`' if name == 'by_film' else '`check`'} | {' | '.join(found)} |")
    return lines


def main() -> None:
    rows = rows_of(recordings_asked(__doc__))
    print("\n".join([*summary(rows), "", *table(rows)]))
    print("\n`not seen`: " + "; ".join(f"{row.name}: {row.by_film.why}" for row in rows if not row.by_film.seen))


if __name__ == "__main__":
    main()
