"""Record, as `onebend record` and then `onebend check`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PIL import Image

from onebend import live
from onebend.cli.common import stopped_by_hand
from onebend.errors import OnebendError
from onebend.live.commands import STAGE_NAMES, RecordOptions, recorded
from onebend.recording.folder import read_recording
from onebend.report.overview import overview
from onebend.studio.learned import known_curve
from onebend.studio.recordings import jpeg_in
from onebend.studio.worker import Studio

WIDEST = 800  # px
QUALITY = 60  # of JPEG
_AS_THEY_ARE = (
    *("advice", "displacement", "largest", "half_width", "wider", "until", "seconds", "frames", "drops", "samples"),
    *("lost_samples", "bytes", "disk_left"),
)


def work(studio: Studio, *, folder: Path, asked: RecordOptions, settings: live.CaptureSettings, **_more: Any) -> None:
    """The push, then its check. An interrupt, or the end of the studio, ends the film."""

    def line(state: live.CaptureState, before: live.CaptureState | None) -> dict[str, Any]:
        length = {"length_m": read_recording(folder, filmed=False).beam.length} if before is None else {}
        return length | capture_line(state, before)

    with stopped_by_hand() as (stop, begin), studio.watching(line) as watch:
        studio.obeyed(stop.set, begin=begin, stop=stop)
        outcome = recorded(folder, asked, settings, watch, stop, begin)
    said = {"fault": outcome.fault, "begun": outcome.film is not None}
    studio.tell({"outcome": live.outcome_data(outcome) | said})
    if outcome.film is not None and not studio.gone.is_set():
        studio.tell({"check": check_data(outcome.folder)})


def capture_line(state: live.CaptureState, before: live.CaptureState | None) -> dict[str, Any]:
    """A state as a line; picture and curve only if new."""
    said: dict[str, Any] = {"state": state_data(state)}
    if state.picture is not None and (before is None or state.picture is not before.picture):
        said["picture"] = jpeg_in(Image.fromarray(state.picture), WIDEST, QUALITY)
    if state.stiffness is not None and (before is None or state.stiffness is not before.stiffness):
        said["curve"] = known_curve(state.stiffness)
    return said


def state_data(state: live.CaptureState) -> dict[str, Any]:
    order = list(STAGE_NAMES)
    tags = [
        {"id": tag.id, "side_px": tag.side_px, "corners_px": tag.corners.round(1) if tag.seen else None}
        for tag in state.tags
    ]
    return {
        "stages": list(STAGE_NAMES.values()),
        "stage": order.index(state.stage),
        "size_px": None if state.picture is None else state.picture.shape[::-1],
        "tags": tags,
        "outline_px": state.outline.round(1),
        "tag_s": sorted({tag.s for tag in state.tags if not tag.on_base}),
        "force_N": state.force,
        "tare_N": state.tare,
        "k_says": "" if state.live is None else state.live.verdict.headline,
        "clock_sd_s": state.clock_sd,
        **{name: getattr(state, name) for name in _AS_THEY_ARE},
    }


def check_data(folder: Path) -> dict[str, Any]:
    try:
        found = overview(folder)
    except OnebendError as error:
        return {"rows": [], "remarks": [], "faults": [str(error)]}
    remarks = [remark.as_dict() for remark in found.remarks]
    return {"rows": found.rows, "remarks": remarks, "faults": found.faults}
