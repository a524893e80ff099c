from .camera import measure_markers as measure_markers
from .entries import (
    BeamEntry as BeamEntry,
    CameraEntry as CameraEntry,
    ForceEntry as ForceEntry,
    FrequencyEntry as FrequencyEntry,
    GravityEntry as GravityEntry,
    MarkersEntry as MarkersEntry,
    MassEntry as MassEntry,
    OutlineEntry as OutlineEntry,
    PhotosEntry as PhotosEntry,
    PosesEntry as PosesEntry,
    PushEntry as PushEntry,
    Recording as Recording,
    TagEntry as TagEntry,
    TagsEntry as TagsEntry,
    VideoEntry as VideoEntry,
)
from .folder import read_recording as read_recording
from .observe import Detect as Detect, ObserveSettings as ObserveSettings
from .tag_finder import PrintedTag as PrintedTag
from .tags import TrackedFrame as TrackedFrame, Tracker as Tracker, detect_tags as detect_tags
from .video import FilmFrame as FilmFrame, KeptFrames as KeptFrames, read_frames as read_frames
