"""Photos of static poses: printed tags on the body, or the body's own edges, followed from the clamp to its tip.

Without tags on the body its curve is found as in a film (`recording.outline`), in each picture alone. A few points that
a person clicks along the body say where to look. The plane and the scale are those of a tag on the bench; without one
the body's own length between the first and the last click is the scale, and the picture is level and square to the
plane of bending.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError
from scipy.interpolate import PchipInterpolator

from onebend.errors import ObservationError, RecordingError
from onebend.progress import Progress, Silent, track
from onebend.recording import beam_frame, camera, flanks, signals, tables, tag_finder, video
from onebend.recording.entries import Recording
from onebend.recording.outline import PLACES, POINTS, STATION, OutlineSearch, centreline, points_of, refuse_lost
from onebend.recording.plane import lay_square, project, scale_of, to_plane, view_of
from onebend.recording.poses import ERROR_LENGTH, GUESSED_SD, PoseLoads, PosePoints, read_loads, static
from onebend.recording.tags import track_block
from onebend.recording.tracks import chord_angles
from onebend.records import (
    POINT_ID,
    Array,
    BoolArray,
    Detections,
    Markers,
    Observations,
    OutlineTrack,
    Readings,
    Remark,
    View,
    covariance_with_camera,
)

Traced = tuple[PosePoints, tuple[OutlineTrack, ...]]


def photo_observations(
    rec: Recording, *, progress: Progress = Silent()
) -> tuple[Observations, tuple[OutlineTrack, ...]]:
    """Observations from a folder of photos and a table of loads; and, without tags on the body, its curve in each."""
    assert rec.photos is not None
    loads = read_loads(rec.photos.loads, rec, rec.photos.axes)
    points, tracks = (tag_points if rec.tags.on_beam else curve_points)(rec, loads, progress)
    return static(rec, loads, points, rec.photos.load_sd), tracks


def tag_points(rec: Recording, loads: PoseLoads, progress: Progress) -> Traced:
    """The tags on the body."""
    assert rec.photos is not None
    if rec.photos.clicks is not None:
        raise RecordingError(
            f"{rec.folder}: [photos] clicks are of a body without tags. Remove them, or [[tags.on_beam]]."
        )
    markers = measured(detect_in_photos(rec, loads.names, progress), rec)
    rough = chord_angles(markers.xy, markers.s)
    turns = np.round(np.nan_to_num(rough - markers.angle) / (2 * np.pi))  # from photo to photo an angle may jump
    markers = replace(markers, angle=markers.angle + 2 * np.pi * turns)
    return points_of_markers(*in_beam_frame(rec, markers, loads)), ()


def points_of_markers(markers: Markers, clamp_sd: float, remarks: tuple[Remark, ...]) -> PosePoints:
    """The markers as points of poses."""
    alike = {one.name: vars(markers)[one.name] for one in fields(PosePoints) if one.name in vars(markers)}
    return PosePoints(**alike | {"remarks": (*markers.remarks, *remarks)}, sd_known=True, clamp_sd=clamp_sd)


def detect_in_photos(rec: Recording, names: tuple[str, ...], progress: Progress = Silent()) -> Detections:
    """Corners of the tags in every picture, in the order of `names`."""
    assert rec.photos is not None
    ids = [tag.id for tag in (*rec.tags.on_base, *rec.tags.on_beam)]
    finder, base = tag_finder.Finder(rec.tags.family), len(rec.tags.on_base)
    corners, sizes, remarks = [], [], []
    for i, name in track(progress, "Finding the tags", list(enumerate(names)), len(names)):
        picture = np.asarray(read_photo(rec, name).convert("L"))
        block = track_block([video.FilmFrame(i, float(i), picture)], ids, finder)
        is_found = np.isfinite(block.corners[0]).all(axis=(1, 2))
        if block.doubles:
            raise ObservationError(f"{name}: tag {block.doubles[0][1]} is in the picture twice. Cover one of them.")
        if not is_found[:base].any():
            raise ObservationError(
                f"{name}: no base tag (id {', '.join(map(str, ids[:base]))}) is found in it. Check [tags] in "
                "recording.toml, and that the tag is in the picture, in focus and at least 20 pixels wide.",
                about="unseen tag",
            )
        hidden = [str(ids[k]) for k in range(base, len(ids)) if not is_found[k]]
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


def read_photo(rec: Recording, name: str) -> Image.Image:
    """The picture in colour, upright as its EXIF orientation says.

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
            return ImageOps.exif_transpose(image).convert("RGB")
    except (UnidentifiedImageError, OSError, ValueError, Image.DecompressionBombError) as wrong:
        raise RecordingError(
            f"{path} cannot be read as a picture ({wrong}). Save it as JPEG or PNG. An iPhone, which takes HEIC, takes "
            "JPEG with Settings, Camera, Formats, Most Compatible."
        ) from None


def measured(
    detections: Detections, rec: Recording, trace: Callable[[int, View], OutlineTrack] | None = None
) -> Markers:
    """The tags' poses: one plane for all pictures, or one plane each where the camera was moved. `trace` finds the
    body's curve in a picture, by its number and the view of the base tag's plane and frame."""
    assert rec.photos is not None
    count = len(detections.time)
    parts = [slice(i, i + 1) for i in range(count)] if rec.photos.camera_moves else [slice(count)]
    found = []
    for part in parts:
        some = replace(detections, time=detections.time[part], corners=detections.corners[part])
        tags = camera.measure_tags(some, rec)
        one = tags.markers()
        if trace is not None:
            views = zip(range(count)[part], base_views(rec, one, some.corners[:, 0]), strict=True)
            one = tags.markers(joined([trace(i, view) for i, view in views]))
        # These fits have no unknowns of the camera: the doubt about it goes into every picture's covariance.
        found.append(replace(one, covariance=covariance_with_camera(one), by_camera=None))
    remarks = {remark.text: remark for one in found for remark in one.remarks}.values()
    return replace(
        found[0],
        time=detections.time,
        xy=np.concatenate([one.xy for one in found]),
        angle=np.concatenate([one.angle for one in found]),
        covariance=np.concatenate([one.covariance for one in found]),
        base_angle=np.concatenate([one.base_angle for one in found]),
        remarks=tuple(remarks),
    )


def base_views(rec: Recording, markers: Markers, corners: Array) -> list[View]:
    """The view of the first base tag's plane and frame in each picture, by its corners (P, 4, 2) px; where hidden,
    as in the first."""
    assert markers.view is not None
    xy, angle = lay_square(to_plane(markers.view, corners))
    xy, angle = np.nan_to_num(xy), np.nan_to_num(angle - rec.tags.on_base[0].turn)
    return [view_of(markers.view, *one) for one in zip(xy, angle.tolist(), strict=True)]


def in_beam_frame(rec: Recording, markers: Markers, loads: PoseLoads) -> tuple[Markers, float, tuple[Remark, ...]]:
    """The markers with x along the bare beam, else along the base tag; and that direction's sd, rad (NaN: not
    stated)."""
    assert rec.photos is not None
    stated = rec.photos.clamp_sd
    bare: BoolArray = np.asarray(~np.any(loads.force != 0.0, axis=1))
    if loads.others is not None:
        bare &= ~np.any(loads.others.force != 0.0, axis=(1, 2)) & ~np.any(loads.others.moment != 0.0, axis=1)
    bare &= ~np.any(loads.gravity != 0.0, axis=1)
    if bare.any():
        turned, _, remarks = beam_frame.to_beam_frame(markers, bare, rec.tags.placement_sd, loads.gravity)
        reach = rec.beam.length * float(np.linalg.norm(markers.s))
        # As for a film that shows the beam at rest.
        from_rest = 2.0 * rec.tags.placement_sd / reach if reach > 0.0 else beam_frame.MOUNTING_SD
        return turned, stated if math.isfinite(stated) else from_rest, remarks
    clamp_sd = stated if math.isfinite(stated) else beam_frame.MOUNTING_SD
    turn = f"{math.degrees(clamp_sd):.2g} deg (sd)"
    text = f"No picture shows the bare beam: x is along the base tag, which may be turned by {turn}."
    return markers, clamp_sd, (Remark("note", text),)


# The body's curve: points whose place along the body is free. What is said of it here is its error in one picture: an
# unknown share of the length, alike over some way along it, as of shade on a round body or of a curve drawn by hand.

LONGEST = 1000.0  # px: a picture of a longer body is made smaller; then its edges are as sharp as a film's
ROUNDS = 3  # of the scale, where the body's own length gives it
PIECES = 8  # of the body, whose width is looked for
ALIKE = 0.3  # of the usual width: another is of something else
CLICKED = 2.0  # px: sd of a click
REACHED = 0.2  # of the length: so far from the curve through the clicks may the body be
STRAY = 0.3  # of the way to the nearest click: so far off may the curve through the clicks be there
SIMILAR = 0.35  # of how unlike the clicked colour most of the surroundings are: what is less unlike is the body


@dataclass(frozen=True)
class Clicks:
    """Points that a person clicked along the middle of the body, the first where it leaves the clamp."""

    px: Array  # (n, 2) px
    s: float  # of the last


def read_clicks(rec: Recording, names: tuple[str, ...]) -> tuple[Clicks, ...]:
    """The clicks in every picture."""
    assert rec.photos is not None
    assert rec.photos.clicks is not None
    table = tables.read_columns(
        rec.photos.clicks, ("x_px", "y_px"), ("s",), labels=("pose",), kind="table of clicks", strict=True
    )
    s, px = table.get("s"), np.stack([table.get("x_px"), table.get("y_px")], axis=1)
    table.refuse(np.asarray(~np.isfinite(px).all(axis=1)), "a click needs x_px and y_px.")
    table.refuse((s <= 0.0) | (s > 1.0), "s of the last click lies above 0 and is at most 1. Leave it empty elsewhere.")
    pose, out, number = np.array(table.labels["pose"]), [], np.arange(len(s))
    table.refuse(~np.isin(pose, names), f"the pose is not in {rec.photos.loads.name}. Name it there.")
    for name in names:
        rows = np.flatnonzero(pose == name)
        if len(rows) < 2:
            raise RecordingError(
                f"{rec.photos.clicks}: {name} has {len(rows)} clicks. Give two or more along the middle of the body: "
                "the first where it leaves the clamp, the last at its tip."
            )
        table.refuse(np.isfinite(s) & np.isin(number, rows[:-1]), "s is of the last click alone.")
        twice = np.linalg.norm(np.diff(px[rows], axis=0), axis=1) < 1.0
        table.refuse(np.isin(number, rows[1:][twice]), "this click is where the one before is.")
        out.append(Clicks(px[rows], 1.0 if math.isnan(s[rows[-1]]) else float(s[rows[-1]])))
    return tuple(out)


def curve_points(rec: Recording, loads: PoseLoads, progress: Progress) -> Traced:
    """Points of the body's curve, by its edges, in the beam's frame; and in the pixels of each picture."""
    assert rec.photos is not None
    clicks = read_clicks(rec, loads.names) if rec.photos.clicks is not None else None
    if rec.tags.on_base:
        found, tracks = _beside_base_tag(rec, loads, clicks, progress)
    else:
        assert clicks is not None
        found, tracks = _by_length(rec, loads, clicks, progress)
    variance = (GUESSED_SD * rec.beam.length) ** 2 * np.diag([1.0, 1.0, 0.0])
    readings = Readings(error_length=ERROR_LENGTH * rec.beam.length)
    text = "The size of the curve's error in the pictures is estimated from the fit."
    points = replace(
        found,
        covariance=found.covariance + variance,
        sd_known=False,
        readings=readings,
        remarks=(*found.remarks, Remark("note", text)),
    )
    return points, tracks


def _beside_base_tag(rec: Recording, loads: PoseLoads, clicks: tuple[Clicks, ...] | None, progress: Progress) -> Traced:
    """A base tag gives plane, scale and direction, and the first click the origin; without clicks the tag's middle."""
    detections = detect_in_photos(rec, loads.names, progress)
    origins, tracks = np.zeros((len(loads.names), 2)), []

    def trace(i: int, view: View) -> OutlineTrack:
        name, clicked = loads.names[i], None if clicks is None else clicks[i]
        if clicked is not None:
            origins[i] = to_plane(view, clicked.px[0])
        tracks.append(track_in(found_in(rec, name, read_photo(rec, name), view_of(view, origins[i], 0.0), clicked)))
        return tracks[-1]

    markers = measured(detections, rec, trace)
    assert markers.view is not None
    view = view_of(markers.view, origins[0], 0.0)
    markers = replace(markers, xy=markers.xy - origins[:, None], view=view)
    return points_of_markers(*in_beam_frame(rec, markers, loads)), tuple(tracks)


def _by_length(rec: Recording, loads: PoseLoads, clicks: tuple[Clicks, ...], progress: Progress) -> Traced:
    """The body's own length gives the scale; the picture is level."""
    assert rec.photos is not None
    if not np.isfinite(loads.clamp).all():
        raise RecordingError(
            f"{rec.name}: without a tag the pictures are taken as level, and somebody must say which way the body "
            "leaves the clamp. Give base_angle_deg in [gravity] (0 to the right, 180 to the left, 90 upwards), or "
            f"clamp_deg in {rec.photos.loads.name}."
        )
    found, views, tracks = [], [], []
    for i, name in track(progress, "Following the body", list(enumerate(loads.names)), len(loads.names)):
        body = found_by_length(rec, name, clicks[i], float(loads.clamp[i]))
        views.append(smaller_view(body.sight.view, 1.0 / body.smaller))
        tracks.append(track_in(body))
        found.append(camera.points_in_plane(views[-1], tracks[-1]))
    clamp_sd = rec.photos.clamp_sd if math.isfinite(rec.photos.clamp_sd) else beam_frame.MOUNTING_SD
    turn = f"{math.degrees(clamp_sd):.2g} deg (sd)"
    text = f"The body's length gives the scale. The pictures are taken as level, and the clamp as written, to {turn}."
    points = PosePoints(
        tag_id=POINT_ID + np.arange(POINTS),
        s=PLACES,
        xy=np.concatenate([one.xy for one in found]),
        angle=np.concatenate([one.angle for one in found]),
        covariance=np.concatenate([one.covariance for one in found]),
        sd_known=False,
        clamp_sd=clamp_sd,
        view=views[0],
        remarks=(Remark("note", text),),
        traced=np.ones(POINTS, dtype=bool),
    )
    return points, tuple(tracks)


def planes_in(image: Image.Image, smaller: int) -> flanks.Planes:
    """Brightness and colours of a picture, so many times smaller."""
    luma, blue, red = (np.asarray(one) for one in image.convert("YCbCr").reduce(smaller).split())
    return flanks.Planes(luma, np.stack([blue, red]), left=False)


@dataclass(frozen=True)
class FoundBody:
    """The body in one picture."""

    name: str  # of the picture
    sight: flanks.Sight  # of the picture made smaller
    smaller: int  # so many times
    stations: flanks.Stations
    shown: BoolArray  # (M,) which of them lie where the body was clicked
    body: flanks.OutlinedBody


def smaller_view(view: View, times: float) -> View:
    """The view in a picture so many times smaller."""
    matrix = view.matrix.copy()
    matrix[:2, 2] += 0.5
    matrix[:2] /= times
    matrix[:2, 2] -= 0.5
    return replace(view, matrix=matrix)


def level_view(origin: Array, scale: float, clamp: float) -> View:
    """A level picture, square to the plane: `origin` (2,) px, `scale` px/m, and the beam's x axis `clamp` rad."""
    cos, sin = math.cos(clamp), math.sin(clamp)
    turn = np.array([[cos, -sin, 0.0], [-sin, -cos, 0.0], [0.0, 0.0, -1.0]])
    return View(np.diag([scale, scale, 1.0]), np.zeros(5), turn, np.append(origin / scale, 1.0), False, CLICKED)


def found_in(rec: Recording, picture: str, image: Image.Image, view: View, clicks: Clicks | None = None) -> FoundBody:
    """The body in a picture whose plane and frame are known: along the clicks, or from the base tag on."""
    length = rec.beam.length
    long = length * scale_of(view, length)  # px
    smaller = max(1, int(long / LONGEST))
    sight = flanks.Sight(planes_in(image, smaller), smaller_view(view, smaller), np.zeros(2))
    stations = flanks.Stations(length, max(2 * POINTS, math.ceil(long / smaller / STATION)))
    s, name, width = stations.s, f"{rec.name}: {picture}", math.nan if rec.outline is None else rec.outline.width
    if clicks is None:
        hidden = s < rec.tags.on_base[0].s + flanks.PAPER * rec.tags.size / length
        place = flanks.BodyPlace(name, sight.view, stations, hidden, width)
        return FoundBody(name, sight, smaller, stations, ~hidden, flanks.grown(sight, place))
    end = STATION * smaller / long  # an edge that ends there is none
    shown = (s > end) & (s < clicks.s - end)
    state = through(stations, to_plane(view, clicks.px), clicks.s)
    body = along(sight, stations, state, shown, width)
    if body is None:
        body = along(sight, stations, caught(sight, stations, state, shown, clicks, smaller), shown, width)
    if body is None:
        raise ObservationError(
            f"{name}: no body is seen along the clicks: no two edges run beside them. Are they of this picture, "
            "upright as it is shown, and along the middle of the body, more of them where it bends? Does it stand out "
            "from its background?",
            about="outline",
        )
    return FoundBody(name, sight, smaller, stations, shown, body)


def found_by_length(rec: Recording, picture: str, clicks: Clicks, clamp: float) -> FoundBody:
    """The body in a level picture, its length between the first and the last click as written."""
    scale = float(np.sum(np.linalg.norm(np.diff(clicks.px, axis=0), axis=1))) / (rec.beam.length * clicks.s)
    origin, image = clicks.px[0], read_photo(rec, picture)
    for _ in range(ROUNDS):
        view = level_view(origin, scale, clamp)
        found = found_in(rec, picture, image, view, clicks)
        places, feet = feet_on(found.stations.curve(found.body.state), found.stations, to_plane(view, clicks.px))
        origin = project(view, feet[0])
        scale *= (places[-1] - places[0]) / clicks.s
    return found


def through(stations: flanks.Stations, points: Array, last: float) -> Array:
    """(1 + K,) numbers of a smooth curve through points (n, 2) m, the last of them at s = `last`."""
    t = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    line = PchipInterpolator(t, points)
    fine = np.linspace(0.0, t[-1], 40 * len(t))
    tangent, places = line.derivative()(fine), line(fine)
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    angle = np.interp(stations.s, last * way / way[-1], np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0])))
    sd = CLICKED * stations.length / stations.count  # rad
    rows = np.vstack([stations.functions / sd, np.diag(1.0 / stations.prior[1:])])
    return np.append(0.0, np.linalg.lstsq(rows, np.append(angle / sd, np.zeros(flanks.STATES)), rcond=None)[0])


def feet_on(curve: flanks.Curve, stations: flanks.Stations, points: Array) -> tuple[Array, Array]:
    """(n,) places s and (n, 2) m on the curve that are nearest to points (n, 2); beyond its ends straight on."""
    nearest = np.argmin(np.linalg.norm(points[:, None] - curve.xy, axis=2), axis=1)
    tangent = np.stack([np.cos(curve.angle), np.sin(curve.angle)], axis=1)[nearest]
    on = np.sum((points - curve.xy[nearest]) * tangent, axis=1)
    return stations.s[nearest] + on / stations.length, curve.xy[nearest] + on[:, None] * tangent


def caught(
    sight: flanks.Sight, stations: flanks.Stations, state: Array, shown: BoolArray, clicks: Clicks, smaller: int
) -> Array:
    """(1 + K,) numbers of a curve nearer to the middle of what has the colour of the clicked pixels, where the clicks
    are few and the curve through them leaves the body between them."""
    px = (clicks.px + 0.5) / smaller - 0.5
    inward = np.array([px[1] - px[0], *np.zeros((len(px) - 2, 2)), px[-2] - px[-1]])
    inward *= STATION / np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), STATION)  # off the body's ends
    around = np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), axis=-1).reshape(-1, 2)
    colours = np.nanmedian(sight.planes.at((px + inward)[:, None] + around), axis=1)  # (n, 3)
    for _ in range(ROUNDS):
        curve = stations.curve(state)
        places, _ = feet_on(curve, stations, to_plane(sight.view, px))
        own = np.stack([np.interp(stations.s, np.maximum.accumulate(places), one) for one in colours.T], axis=1)
        normal, scale = sight.outward(curve)
        out = (
            np.arange(-REACHED, REACHED, flanks.STEP / float(np.median(scale) * stations.length)) * stations.length
        )  # m
        seen = sight.planes.at(sight.pixels(curve.xy)[:, None] + (out * scale[:, None])[..., None] * normal[:, None])
        unlike = np.linalg.norm(seen - own[:, None], axis=-1)
        like = unlike < SIMILAR * np.nan_to_num(np.nanquantile(unlike, 0.8, axis=1))[:, None]
        off = np.array([_nearest_run(one, out) for one in like])
        gap = stations.length * np.abs(stations.s[:, None] - places).min(axis=1)  # m, to the nearest click
        off = np.where(np.abs(off) < STRAY * gap, off, 0.0)
        state = stations.fitted(state, np.where(shown, off, np.nan), CLICKED / float(np.median(scale)))
    return state


def _nearest_run(like: BoolArray, out: Array) -> float:
    """Middle of the run of similar places (J,) that is nearest to 0 among these `out` (J,); NaN where there is none."""
    begin, end = signals.runs(like).T
    first, last = out[begin], out[end - 1]
    if not len(first):
        return math.nan
    nearest = int(np.argmin(np.maximum(first, 0.0) + np.maximum(-last, 0.0)))
    return float(0.5 * (first[nearest] + last[nearest]))


def along(
    sight: flanks.Sight, stations: flanks.Stations, state: Array, shown: BoolArray, width: float
) -> flanks.OutlinedBody | None:
    """The body along the curve of `state` where it is `shown` (M,), `width` m near the clamp (NaN: unknown); None where
    no two edges run along it."""
    pieces = np.array_split(np.flatnonzero(shown), PIECES)
    middle = np.array([float(np.mean(stations.s[piece])) for piece in pieces])
    half, clicked, usual = np.full(stations.count, np.nan), state, math.nan

    def strays(new: Array) -> bool:
        """Whether a curve lies farther from the clicks than the body is wide."""
        return not np.max(np.abs(stations.across(stations.curve(clicked)) @ (new - clicked))[shown]) <= usual

    for _ in range(ROUNDS):
        curve = stations.curve(state)
        parts = (np.isin(np.arange(stations.count), piece) for piece in pieces)
        sides = np.stack([flanks.first_width(sight, curve, part, stations.length) for part in parts])
        wide = sides.sum(axis=1)
        usual = float(signals.nan_median(wide)) if math.isnan(width) else width
        well = np.abs(wide - usual) < ALIKE * usual
        if not well.any():
            break
        off = np.interp(stations.s, middle[well], 0.5 * (sides[well, 0] - sides[well, 1]))
        half[:], sd = 0.5 * usual, CLICKED / float(np.median(sight.outward(curve)[1]))
        new = stations.fitted(state, np.where(shown, off, np.nan), sd)
        if strays(new):
            break
        state = new
    step = flanks.edge_size(sight, stations.curve(state), half, shown) if np.isfinite(half).all() else 0.0
    body = flanks.refined(sight, stations, state, half, shown, step)
    for _ in range(ROUNDS):
        body = None if body is None else flanks.refined(sight, stations, body.state, body.half, shown, step)
    return None if body is None or strays(body.state) else body


def track_in(found: FoundBody) -> OutlineTrack:
    """Points of the body's centreline, in pixels of the whole picture."""
    sight, stations, body = found.sight, found.stations, found.body
    curve = stations.curve(body.state)
    scale = float(np.median(sight.outward(curve)[1]))
    away = np.where(found.shown, flanks.find_flanks(sight, curve, body.half, body.look), np.nan)
    search = OutlineSearch(body.state[None], away[None])
    middle = centreline(search, stations, body.half, flanks.MEASURED / scale)
    refuse_lost(middle, search, found.shown, found.name)
    track = points_of(middle, search, stations, sight.view, sight.shift[None], scale)
    times = found.smaller
    px, ahead = ((one + 0.5) * times - 0.5 for one in (track.px, track.ahead))
    return replace(track, px=px, ahead=ahead, sd=times * track.sd)


def joined(tracks: Sequence[OutlineTrack]) -> OutlineTrack:
    """Those of several pictures."""
    px, ahead, sd = (np.concatenate([getattr(one, name) for one in tracks]) for name in ("px", "ahead", "sd"))
    return replace(tracks[0], px=px, ahead=ahead, sd=sd)
