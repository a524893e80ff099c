"""Files to observations: pixels, clocks, sensors. Knows no mechanics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import lazy_names

if TYPE_CHECKING:
    from onebend.recording.camera.projection import measure_markers as measure_markers
    from onebend.recording.clock.offset import ClockSettings as ClockSettings
    from onebend.recording.folder import read_recording as read_recording
    from onebend.recording.force.cleaning import ForceSettings as ForceSettings
    from onebend.recording.force.contact import ContactSettings as ContactSettings
    from onebend.recording.kept_frames import KeptFrames as KeptFrames
    from onebend.recording.observe import Detect as Detect
    from onebend.recording.observe import ObserveSettings as ObserveSettings
    from onebend.recording.tags.detection import detect_tags as detect_tags
    from onebend.recording.tags.printed_code import PrintedTag as PrintedTag
    from onebend.recording.tags.tracker import TrackedFrame as TrackedFrame
    from onebend.recording.tags.tracker import Tracker as Tracker
    from onebend.recording.toml.beam_entry import BeamEntry as BeamEntry
    from onebend.recording.toml.beam_entry import MassEntry as MassEntry
    from onebend.recording.toml.entries import ForceEntry as ForceEntry
    from onebend.recording.toml.entries import GravityEntry as GravityEntry
    from onebend.recording.toml.entries import PushEntry as PushEntry
    from onebend.recording.toml.entries import Recording as Recording
    from onebend.recording.toml.entries import TagEntry as TagEntry
    from onebend.recording.toml.entries import TagsEntry as TagsEntry
    from onebend.recording.toml.frequency_entry import FrequencyEntry as FrequencyEntry
    from onebend.recording.toml.source_entries import CameraEntry as CameraEntry
    from onebend.recording.toml.source_entries import MarkersEntry as MarkersEntry
    from onebend.recording.toml.source_entries import PhotosEntry as PhotosEntry
    from onebend.recording.toml.source_entries import PosesEntry as PosesEntry
    from onebend.recording.toml.source_entries import VideoEntry as VideoEntry
    from onebend.recording.video import FilmFrame as FilmFrame
    from onebend.recording.video import read_frames as read_frames
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.recording.camera.projection": "measure_markers",
            "onebend.recording.clock.offset": "ClockSettings",
            "onebend.recording.folder": "read_recording",
            "onebend.recording.force.cleaning": "ForceSettings",
            "onebend.recording.force.contact": "ContactSettings",
            "onebend.recording.kept_frames": "KeptFrames",
            "onebend.recording.observe": "Detect ObserveSettings",
            "onebend.recording.tags.detection": "detect_tags",
            "onebend.recording.tags.printed_code": "PrintedTag",
            "onebend.recording.tags.tracker": "TrackedFrame Tracker",
            "onebend.recording.toml.beam_entry": "BeamEntry MassEntry",
            "onebend.recording.toml.frequency_entry": "FrequencyEntry",
            "onebend.recording.toml.entries": "ForceEntry GravityEntry PushEntry Recording TagEntry TagsEntry",
            "onebend.recording.toml.source_entries": "CameraEntry MarkersEntry PhotosEntry PosesEntry VideoEntry",
            "onebend.recording.video": "FilmFrame read_frames",
        },
    )
