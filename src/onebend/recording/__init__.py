"""Files to observations: pixels, clocks, sensors. Knows no mechanics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import lazy_names

if TYPE_CHECKING:
    from onebend.recording.camera import measure_markers as measure_markers
    from onebend.recording.clock import ClockSettings as ClockSettings
    from onebend.recording.entries import (
        BeamEntry as BeamEntry,
        CameraEntry as CameraEntry,
        ForceEntry as ForceEntry,
        FrequencyEntry as FrequencyEntry,
        GravityEntry as GravityEntry,
        MarkersEntry as MarkersEntry,
        MassEntry as MassEntry,
        PhotosEntry as PhotosEntry,
        PosesEntry as PosesEntry,
        PushEntry as PushEntry,
        Recording as Recording,
        TagEntry as TagEntry,
        TagsEntry as TagsEntry,
        VideoEntry as VideoEntry,
    )
    from onebend.recording.folder import read_recording as read_recording
    from onebend.recording.force import ContactSettings as ContactSettings, ForceSettings as ForceSettings
    from onebend.recording.observe import Detect as Detect, ObserveSettings as ObserveSettings
    from onebend.recording.tag_finder import PrintedTag as PrintedTag
    from onebend.recording.tags import TrackedFrame as TrackedFrame, Tracker as Tracker, detect_tags as detect_tags
    from onebend.recording.video import FilmFrame as FilmFrame, KeptFrames as KeptFrames, read_frames as read_frames
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.recording.camera": "measure_markers",
            "onebend.recording.clock": "ClockSettings",
            "onebend.recording.entries": (
                "BeamEntry CameraEntry ForceEntry FrequencyEntry GravityEntry MarkersEntry MassEntry PhotosEntry "
                "PosesEntry PushEntry Recording TagEntry TagsEntry VideoEntry"
            ),
            "onebend.recording.folder": "read_recording",
            "onebend.recording.force": "ContactSettings ForceSettings",
            "onebend.recording.observe": "Detect ObserveSettings",
            "onebend.recording.tag_finder": "PrintedTag",
            "onebend.recording.tags": "TrackedFrame Tracker detect_tags",
            "onebend.recording.video": "FilmFrame KeptFrames read_frames",
        },
    )
