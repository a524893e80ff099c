"""Photos of the tags to observations, one static pose a photo. Times in the files are not used."""

from __future__ import annotations

import math
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from onebend.errors import ObservationError, RecordingError
from onebend.progress import Progress, Silent, track
from onebend.recording.beam_frame import MOUNTING_SD, to_beam_frame
from onebend.recording.camera.projection import measure_markers
from onebend.recording.tags.finder import Finder
from onebend.recording.tags.tracking import track_block
from onebend.recording.toml.entries import Recording
from onebend.recording.tracks.chords import chord_angles
from onebend.recording.tracks.pose_loads import PoseLoads, read_loads
from onebend.recording.tracks.pose_tables import PosePoints, static
from onebend.recording.video import FilmFrame, Picture
from onebend.records import BoolArray, Detections, Markers, Observations, Remark, covariance_with_camera

HEIC_BRANDS = frozenset((b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx"))


def photo_observations(rec: Recording, *, progress: Progress = Silent()) -> Observations:
    """Observations from a folder of photos and a table of loads.

    Raises:
        RecordingError: a picture or the table cannot be used.
        ObservationError: tags that are not seen, or that no flat plane explains.
    """
    assert rec.photos is not None
    loads = read_loads(rec.photos.loads, rec, rec.photos.axes)
    detections = detect_in_photos(rec, loads.names, progress)
    markers = measured(detections, rec)
    rough = chord_angles(markers.xy, markers.s)
    turns = np.round(np.nan_to_num(rough - markers.angle) / (2 * np.pi))  # from photo to photo an angle may jump
    markers = replace(markers, angle=markers.angle + 2 * np.pi * turns)
    markers, clamp_sd, remarks = in_beam_frame(rec, markers, loads)
    points = PosePoints(
        xy=markers.xy,
        angle=markers.angle,
        covariance=markers.covariance,
        sd_known=True,
        clamp_sd=clamp_sd,
        view=markers.view,
        remarks=(*markers.remarks, *remarks),
    )
    return static(rec, loads, points, rec.photos.load_sd)


def detect_in_photos(rec: Recording, names: tuple[str, ...], progress: Progress = Silent()) -> Detections:
    """Corners of the tags in every picture, in the order of `names`."""
    assert rec.photos is not None
    ids = [tag.id for tag in (*rec.tags.on_base, *rec.tags.on_beam)]
    finder, base = Finder(rec.tags.family), len(rec.tags.on_base)
    corners, sizes, remarks = [], [], []
    for i, name in track(progress, "Finding the tags", list(enumerate(names)), len(names)):
        picture = read_photo(rec, name)
        block = track_block([FilmFrame(i, float(i), picture)], ids, finder)
        is_found = np.isfinite(block.corners[0]).all(axis=(1, 2))
        if block.doubles:
            raise ObservationError(f"{name}: tag {block.doubles[0][1]} is in the picture twice. Cover one of them.")
        if not is_found[:base].any():
            raise ObservationError(
                f"{name}: no base tag (id {', '.join(map(str, ids[:base]))}) is found in it. Check [tags] in "
                "recording.toml, and that the tag is in the picture, in focus and at least 20 pixels wide.",
                about="unseen tag",
            )
        hidden = [str(tag) for tag, shown in zip(ids[base:], is_found[base:].tolist(), strict=True) if not shown]
        remarks += [Remark("note", f"{name} does not show tag {', '.join(hidden)}.")] if hidden else []
        corners.append(block.corners[0])
        sizes.append(picture.shape)
    if len(set(sizes)) > 1:
        other_size = next(name for name, size in zip(names, sizes, strict=True) if size != sizes[0])
        raise ObservationError(
            f"{other_size} is not as large as {names[0]}. Take all pictures at one size, without zooming."
        )
    height, width = sizes[0]
    time = np.arange(len(names), dtype=float)
    return Detections(time, np.array(ids), np.stack(corners), width, height, tuple(remarks))


def read_photo(rec: Recording, name: str) -> Picture:
    """The picture's brightness, upright as its EXIF orientation says.

    Raises `RecordingError` where it is missing or no picture.
    """
    assert rec.photos is not None
    path = rec.photos.folder / name
    if not path.is_file():
        files = ", ".join(sorted(item.name for item in rec.photos.folder.iterdir())[:5]) or "nothing"
        raise RecordingError(
            f"{rec.photos.loads}: the pose {name} has no picture {path}. The folder holds {files}. Write the file's "
            "name, with its ending, in the column pose."
        )
    try:
        with Image.open(path) as image:
            return np.asarray(ImageOps.exif_transpose(image).convert("L"))
    except (UnidentifiedImageError, OSError, ValueError, Image.DecompressionBombError) as wrong:
        if is_heic(path):
            raise RecordingError(_heic_words(path)) from None
        raise RecordingError(f"{path} cannot be read as a picture ({wrong}). Save it as JPEG or PNG.") from None


def is_heic(path: Path) -> bool:
    """Whether a file begins as an HEIC picture does (ISO 23008-12), whatever its name."""
    with path.open("rb") as stream:
        first = stream.read(64)
    size = min(int.from_bytes(first[:4], "big"), len(first))
    brands = {first[8:12], *(first[i : i + 4] for i in range(16, size - 3, 4))}
    return first[4:8] == b"ftyp" and not brands.isdisjoint(HEIC_BRANDS)


def _heic_words(path: Path) -> str:
    """How to convert a picture. (The programs that read HEIC come with the systems; their licences, LGPL and GPL, are
    not those of a library to ask for.)"""
    other = path.with_name(f"{path.stem}-converted.jpg" if path.suffix == ".jpg" else f"{path.stem}.jpg")
    old, new = shlex.quote(str(path)), shlex.quote(str(other))
    return (
        f"{path} is an HEIC picture, as telephones take them; JPEG and PNG are read. Convert it with "
        f"`sips -s format jpeg {old} --out {new}` on a Mac or `heif-convert -q 100 {old} {new}` on Linux (from the "
        "package libheif-examples), and write the new name in the column pose. An iPhone takes JPEG by itself with "
        "Settings, Camera, Formats, Most Compatible."
    )


def measured(detections: Detections, rec: Recording) -> Markers:
    """The tags' poses: one plane for all pictures, or one plane each where the camera was moved."""
    assert rec.photos is not None
    if not rec.photos.camera_moves:
        return with_camera_as_noise(measure_markers(detections, rec))
    per_photo = []
    for i in range(len(detections.time)):
        photo = replace(detections, time=detections.time[i : i + 1], corners=detections.corners[i : i + 1], remarks=())
        per_photo.append(with_camera_as_noise(measure_markers(photo, rec)))
    return replace(
        per_photo[0],
        time=detections.time,
        xy=np.concatenate([photo.xy for photo in per_photo]),
        angle=np.concatenate([photo.angle for photo in per_photo]),
        covariance=np.concatenate([photo.covariance for photo in per_photo]),
        base_angle=np.zeros(len(per_photo)),
        remarks=(
            *detections.remarks,
            *{remark.text: remark for photo in per_photo for remark in photo.remarks}.values(),
        ),
    )


def with_camera_as_noise(markers: Markers) -> Markers:
    """The doubt about camera and plane in every picture's covariance, for fits that have no unknowns of the camera."""
    return replace(markers, covariance=covariance_with_camera(markers), by_camera=None)


def in_beam_frame(rec: Recording, markers: Markers, loads: PoseLoads) -> tuple[Markers, float, tuple[Remark, ...]]:
    """The markers with x along the bare beam where a picture shows it, else along the base tag; and one sd of that
    direction, rad (NaN: not stated)."""
    assert rec.photos is not None
    stated = rec.photos.clamp_sd
    bare: BoolArray = np.asarray(~np.any(loads.force != 0.0, axis=1))
    if loads.others is not None:
        bare &= ~np.any(loads.others.force != 0.0, axis=(1, 2)) & ~np.any(loads.others.moment != 0.0, axis=1)
    bare &= ~np.any(loads.gravity != 0.0, axis=1)
    if bare.any():
        turned, _, remarks = to_beam_frame(markers, bare, rec.tags.placement_sd, loads.gravity)
        reach = rec.beam.length * float(np.linalg.norm(markers.s))
        # As for a film that shows the beam at rest.
        from_rest = 2.0 * rec.tags.placement_sd / reach if reach > 0.0 else MOUNTING_SD
        return turned, stated if math.isfinite(stated) else from_rest, remarks
    clamp_sd = stated if math.isfinite(stated) else MOUNTING_SD
    turn = f"{math.degrees(clamp_sd):.2g} deg (sd)"
    text = f"No picture shows the bare beam: x is along the base tag, which may be turned by {turn}."
    return markers, clamp_sd, (Remark("note", text),)
