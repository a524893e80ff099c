"""The folder of a recording while it is recorded: what recording.toml must say, the logs, and how much room is left."""

from __future__ import annotations

import math
import queue
import re
import shutil
import threading
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from onebend.errors import RecordingError, ResultsError
from onebend.files.single_file import GrowingFile, write_file
from onebend.live import sources
from onebend.live.sources import CameraSource, Clock, End, ForceSource, Frame, Samples, StampedClock, StampTiming
from onebend.progress import available_cores
from onebend.recording.entries import Recording
from onebend.recording.folder import FILE_NAME, folder_of, read_recording
from onebend.recording.video import Picture
from onebend.records import Array
from onebend.text_files import MOST_TOML, read_text, read_toml

STAMPS = "frames.csv"
STAMP_COLUMNS = ("time_s", "number", "stamp_s", "arrival_s")
LEAST_STEP = 1e-6  # s between rows: times of a log must rise


@dataclass(frozen=True)
class RecordingPlaces:
    """Where what is recorded goes."""

    rec: Recording
    film: Path
    log: Path | None
    stamps: Path  # of the frames, as the camera gave them and as they came
    wanted: tuple[int, int] = (0, 1)  # which columns of the sensor are the two of recording.toml
    push_column: int | None = None  # and which says where the push acts
    earlier: tuple[Path, ...] = ()  # files that are to be replaced


def places_for(
    folder: Path | str, columns: tuple[str, ...] | None, *, overwrite: bool = False, read: tuple[Path, ...] = ()
) -> RecordingPlaces:
    """Read recording.toml, and check that a camera and a sensor of these `columns` (None: no sensor) can fill it.

    The sources read the files `read`; these are not replaced, not even with `overwrite`.

    Raises:
        RecordingError: what is wrong with it, or what is there already.
    """
    rec = read_recording(folder_of(folder), filmed=False)
    where = rec.folder / FILE_NAME
    if rec.video is None or rec.video.topic:
        raise RecordingError(f'{where}: a camera records a film. Write [video] with file = "video.mp4", without topic.')
    film, log = rec.video.file, None
    if film.suffix.lower() not in (".mp4", ".m4v", ".mov"):
        raise RecordingError(
            f'{where}: the film is written as MP4, and [video] file is {film.name}. Name it "video.mp4".'
        )
    if rec.video.frame_times != "container":
        raise RecordingError(f'{where}: the film holds its times. Write frame_times = "container" in [video].')
    if (columns is None) != (rec.force is None):
        no_sensor = "names a [force], and no sensor is given. Give one with --force"
        no_force = "has no [force]. Add [force] and [push], or leave the sensor out"
        raise RecordingError(f"{where} {no_sensor if columns is None else no_force}.")
    named: list[int] = []
    if rec.force is not None and columns is not None:
        log, named = rec.force.file, _named(rec, columns)
    for path in (film, log):
        if path is not None and not path.parent.resolve().is_relative_to(rec.folder.resolve()):
            raise RecordingError(f"{where}: {path} is out of the recording's folder. Name a file in it, as video.mp4.")
    found = [path for path in (film, log, rec.folder / STAMPS) if path is not None and path.exists()]
    if found and (own := [path for path in found for one in read if one.exists() and path.samefile(one)]):
        raise RecordingError(
            f"{own[0]} is what the camera or the sensor reads, and would be replaced. Record into another folder."
        )
    if found and not overwrite:
        raise RecordingError(
            f"{found[0]} is there already. Record into another folder (copy {FILE_NAME}), or add --overwrite to "
            "replace it."
        )
    place = named[2] if len(named) > 2 else None
    wanted = (named[0], named[1]) if named else (0, 1)
    return RecordingPlaces(rec, film, log, rec.folder / STAMPS, wanted, place, tuple(found))


def _named(rec: Recording, columns: tuple[str, ...]) -> list[int]:
    """Which columns of the sensor recording.toml names: two forces, and perhaps the place of the push."""
    force, push, where = rec.force, rec.push, rec.folder / FILE_NAME
    assert force is not None
    if force.topic or force.time_unit != "s" or force.columns[0] != "time_s":
        raise RecordingError(
            f'{where}: the force log is written as a CSV with the column time_s in s. Write columns = ["time_s", '
            f'"{columns[0]}", "{columns[1]}"] in [force], without topic and time_unit.'
        )
    names = (*force.columns[1:], *([push.column] if push is not None and push.column else []))
    for name in names:
        if name not in columns:
            raise RecordingError(
                f"{where}: [force] and [push] name the column {name}, and the sensor gives {', '.join(columns)}. "
                "Correct columns: the two that span the plane of bending."
            )
    return [columns.index(name) for name in names]


def state_values(folder: Path, table: str, values: dict[str, str]) -> None:
    """Write numbers of one table into recording.toml. All else stays as it is.

    Raises:
        RecordingError: the file has no line for it.
    """
    path = folder / FILE_NAME
    content = read_text(path, RecordingError, most=MOST_TOML)
    try:
        write_file(path, with_values(content, table, values), overwrite=True)
    except ResultsError as wrong:
        raise RecordingError(str(wrong)) from None
    said = read_toml(path, RecordingError)[1].get(table, {})
    if not all(math.isclose(said.get(name, math.nan), float(value)) for name, value in values.items()):
        write_file(path, content, overwrite=True)
        lines = ", ".join(f"{name} = {value}" for name, value in values.items())
        raise RecordingError(f"{path}: [{table}] cannot be edited as it is written. Write {lines} into it, as lines.")


def with_values(content: str, table: str, values: dict[str, str]) -> str:
    """TOML text with these keys of a table set: in the place of the line that has them, even commented out, else below
    the table's header; what a line says behind its value stays."""
    lines = content.splitlines(keepends=True)
    header = next((i for i, line in enumerate(lines) if re.match(rf"^\s*\[\s*{table}\s*\]", line)), None)
    if header is None:
        return content
    end = next((i for i in range(header + 1, len(lines)) if re.match(r"^\s*\[", lines[i])), len(lines))
    for name, value in reversed(values.items()):
        at = [i for i in range(header + 1, end) if re.match(rf"^\s*#?\s*{name}\s*=", lines[i])]
        live = [i for i in at if not lines[i].lstrip().startswith("#")]
        if at:
            place = (live or at)[0]
            rest = lines[place].partition("=")[2]
            said = rest[rest.index("#") :].rstrip("\r\n") if "#" in rest else ""
            lines[place] = f"{f'{name} = {value}':<40}  {said}".rstrip() + "\n"
        else:
            lines.insert(header + 1, f"{name} = {value}\n")
            end += 1
    return "".join(lines)


class GrowingTable(GrowingFile):
    """A CSV file that grows: rows are put into it together, whole or not at all."""

    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
        """Raises `OSError` where it is there, or cannot be made."""
        super().__init__(path)
        self.path, self.rows = path, 0
        self._waiting: list[str] = [",".join(columns)]
        self.flush()

    def add(self, rows: Array, formats: tuple[str, ...]) -> None:
        """Rows (n, c), each number as its format says; NaN is an empty cell."""
        for row in rows.tolist():
            cells = ("" if math.isnan(value) else how % value for value, how in zip(row, formats, strict=True))
            self._waiting.append(",".join(cells))
        self.rows += len(rows)

    def flush(self) -> None:
        """Put what waits into the file.

        Raises:
            OSError: the disk is full, or gone; the file then ends with a whole row.
        """
        if not self._waiting:
            return
        self.append(("\n".join(self._waiting) + "\n").encode())
        self._waiting.clear()

    def close(self) -> None:
        """The end. Raises `OSError` as `flush`."""
        try:
            self.flush()
        finally:
            super().close()


def retimed(path: Path, time: Array) -> None:
    """Write the log anew with times (N,) in its first column, in order of time; the old one stays until it is whole.

    Raises:
        OSError: there is no room for it.
    """
    header, *lines = path.read_text(encoding="utf-8").splitlines()
    lines, time = lines[: len(time)], time[: len(lines)]
    order = np.argsort(time, kind="stable")
    steps = LEAST_STEP * np.arange(len(order))
    rising = (np.maximum.accumulate(time[order] - steps) + steps).tolist()
    rows = (f"{at:.6f},{lines[i].partition(',')[2]}" for at, i in zip(rising, order.tolist(), strict=True))
    beside = path.with_name(f".{path.name}.new")
    try:
        beside.write_text("\n".join((header, *rows)) + "\n", encoding="utf-8")
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def room_left(folder: Path) -> float:
    """Bytes left on the disk; NaN where nobody says it."""
    try:
        return float(shutil.disk_usage(folder).free)
    except OSError:
        return math.nan


def copy_description(like: Path, folder: Path) -> None:
    """Begin a recording of the beam of another one: its recording.toml without its name, so that it is called as its
    folder, and the tables of the beam that it names.

    Files that are there already and the same, of a start that failed, are left as they are.

    Raises:
        RecordingError: others are in `folder`, it is no folder, or `like` cannot be read.
    """
    source = folder_of(like)
    rec = read_recording(source, filmed=False)
    if folder.exists() and not folder.is_dir():
        raise RecordingError(f"{folder} is not a folder. Name the folder to record into.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path in (source / FILE_NAME, rec.beam.mass_file, rec.beam.section_file):
            if path is not None:
                target, content = folder / path.relative_to(source), path.read_bytes()
                copied = _unnamed(content) if path.name == FILE_NAME else content
                if not target.exists():
                    if ".." in target.relative_to(folder).parts:
                        raise RecordingError(
                            f"{source / FILE_NAME} names {path}, out of its folder: {target} is not written. Put the "
                            "table into the folder, and name it there."
                        )
                    target.parent.mkdir(parents=True, exist_ok=True)
                    target.write_bytes(copied)
                elif target.read_bytes() not in (copied, content):
                    raise RecordingError(f"{target} exists already. Leave out --like, or name another folder.")
    except (OSError, ValueError) as wrong:
        raise RecordingError(f"{folder}: {source} cannot be copied ({wrong}). Copy {FILE_NAME} by hand.") from None


def _unnamed(content: bytes) -> bytes:
    """recording.toml without the line `name = ...` above its tables; as it is where that is no line of its own."""
    found = re.search(rb"^[ \t]*(name|\"name\"|'name')[ \t]*=.*(\n|\Z)", content, re.MULTILINE)
    table = re.search(rb"^[ \t]*\[", content, re.MULTILINE)
    if found is None or (table is not None and table.start() < found.start()):
        return content
    left = content[: found.start()] + content[found.end() :]
    try:
        before, after = (tomllib.loads(one.decode("utf-8-sig")) for one in (content, left))
    except ValueError:
        return content
    before.pop("name", None)
    return left if before == after else content


# A film that is written while it is filmed: H.264 in MP4 fragments, one a frame, so that what was written can be read
# whatever happens next. Times are the camera's own, to a microsecond.

TIME_BASE = Fraction(1, 1_000_000)
CRF = 18  # what it does to tags: benchmarks/notes/record.md
PRESET = "veryfast"
TUNE = "psnr,zerolatency"  # for what is measured, not for the eye: half of the change of tags, and of the file
KEY_EVERY = 30  # frames
MOST_THREADS = 4
FRAGMENTS = "empty_moov+default_base_moof+frag_every_frame+skip_trailer"


class WholeFragments(GrowingFile):
    """What the muxer writes into: bytes go to the file in whole fragments alone."""

    def __init__(self, path: Path) -> None:
        """Raises `OSError` where the file is there, or cannot be made."""
        super().__init__(path)
        self._waiting = bytearray()

    def write(self, data: bytes) -> int:
        """Keep bytes until the fragment is whole."""
        self._waiting += data
        return len(data)

    def put(self) -> None:
        """Write the boxes that are whole; where they do not fit, the file is as before, and `OSError` raised."""
        whole = whole_boxes(self._waiting)
        if not whole:
            return
        self.append(bytes(self._waiting[:whole]))
        del self._waiting[:whole]


def whole_boxes(data: bytes | bytearray) -> int:
    """Bytes of the whole boxes at the beginning of `data`; a moof counts with its mdat alone."""
    at = good = 0
    while at + 8 <= len(data):
        size, kind = int.from_bytes(data[at : at + 4], "big"), bytes(data[at + 4 : at + 8])
        if size == 1 and at + 16 <= len(data):
            size = int.from_bytes(data[at + 8 : at + 16], "big")
        if size < 8 or at + size > len(data):
            break
        at += size
        good = good if kind == b"moof" else at
    return good


class FilmWriter:
    """One film, from its first frame on."""

    def __init__(self, path: Path, size: tuple[int, int], *, crf: int = CRF) -> None:
        """A film of pictures of `size` (width, height) px.

        Raises:
            RecordingError: the file is there already, cannot be written, or there is no encoder.
        """
        self.path, self.frames, self.last = path, 0, -math.inf  # last: pts
        self.shape = size[1], size[0]
        try:
            self._sink = WholeFragments(path)
        except OSError as wrong:
            raise RecordingError(f"{path} cannot be written ({wrong.strerror}). Choose another folder.") from None
        try:
            self._container = av.open(
                self._sink, "w", format="mp4", options={"movflags": FRAGMENTS, "flush_packets": "1"}
            )
            stream = self._container.add_stream("libx264", rate=30)
            stream.width, stream.height = even(size[0]), even(size[1])
            stream.pix_fmt = "yuv420p"
            stream.codec_context.time_base = TIME_BASE
            stream.options = {
                "crf": str(crf),
                "preset": PRESET,
                "tune": TUNE,
                "g": str(KEY_EVERY),
                "x264-params": "sliced-threads=1",  # slices of one picture: none waits for the next
                "threads": str(min(MOST_THREADS, available_cores())),
            }
        except (av.error.FFmpegError, ValueError) as wrong:
            self._sink.close()
            raise RecordingError(f"{path} cannot be encoded as H.264: {wrong}") from None
        self._stream: Any = stream

    @property
    def bytes(self) -> int:
        """In the file."""
        return self._sink.size

    def write(self, picture: Picture, time: float, colour: Any = None) -> bool:
        """One more picture (H, W) at `time` [s] of the film; False where that is not after the last.

        Raises:
            OSError: the disk is full, or gone. The film then ends with the last whole frame.
        """
        pts = round(time / TIME_BASE)
        if pts <= self.last:
            return False
        frame = with_luma(picture, colour)
        frame.pts, frame.time_base = pts, TIME_BASE
        self._container.mux(self._stream.encode(frame))
        self._sink.put()
        self.frames, self.last = self.frames + 1, pts
        return True

    def close(self) -> None:
        """The end of the film: all frames are in the file. Raises `OSError` as `write`."""
        try:
            if self.frames:
                self._container.mux(self._stream.encode(None))
            self._container.close()
            self._sink.put()
        finally:
            self._sink.close()


def even(size: int) -> int:
    """Of an odd number of rows or columns the last one is left out: colours are of two each."""
    return size - size % 2


def with_luma(picture: Picture, colour: Any) -> av.VideoFrame:
    """The frame to encode: the luma as it is, and the colours of `colour` (`av.VideoFrame`), or none."""
    rows, columns = even(picture.shape[0]), even(picture.shape[1])
    chroma = np.full((rows // 2, columns), 128, np.uint8)
    if colour is not None:
        planes = colour.reformat(width=columns, height=rows, format="yuv420p").to_ndarray()
        chroma = planes[rows:].reshape(rows // 2, columns)
    stacked = np.concatenate([picture[:rows, :columns], chroma])
    return av.VideoFrame.from_ndarray(np.ascontiguousarray(stacked), format="yuv420p")


# The stamps of frames and the rows of the force while they come, on the film's clock: 0 s at its first frame.

ADDED = ("own_s", "arrival_s")  # columns of the log behind the forces: the sensor's own stamps, and when rows came
_TIME, _VALUE = "%.6f", "%.7g"
_LATE_ROW = 1e-6  # s behind the row before, of one that came late; the whole log is put in order at the end
_GAP = 1.6  # intervals: a longer way from stamp to stamp lacks frames


@dataclass
class Drops:
    """Frames that the camera took and that did not come, by its count, or else by its stamps."""

    lost: int = 0
    _number: int = -1
    _stamp: float = math.nan
    _intervals: list[float] = field(default_factory=list)

    def see(self, number: int, stamp: float) -> None:
        """One more frame, later than those before."""
        step = stamp - self._stamp
        if self._number >= 0 and number > self._number:
            self.lost += number - self._number - 1
        elif number < 0 and step > 0.0:
            usual = float(np.median(self._intervals)) if len(self._intervals) >= 5 else math.inf
            self.lost += round(step / usual) - 1 if step > _GAP * usual else 0
        if step > 0.0:
            self._intervals = [*self._intervals[-50:], step]
        self._number, self._stamp = number, stamp


class Logs:
    """Both clocks, and the two tables on disk."""

    def __init__(self, camera: StampTiming, force: StampTiming | None, columns: tuple[str, ...]) -> None:
        """Nothing has come, and nothing is on disk. `columns` of the force."""
        self._camera, self._columns = StampedClock(camera), columns
        self._force = None if force is None else StampedClock(force)
        self._first = math.nan  # s, the camera's clock, of the first frame
        self._last_frame = self._last_row = -math.inf  # s, the film's clock
        self._kept: list[Array] = []  # (n, 2) own stamps and arrivals of the rows, in the order of the file
        self._stamps: GrowingTable | None = None
        self._rows: GrowingTable | None = None
        self._drops = Drops()
        self.lost_samples = 0

    @property
    def _tables(self) -> list[GrowingTable]:
        return [table for table in (self._stamps, self._rows) if table is not None]

    @property
    def drops(self) -> int:
        """Frames that are not in the film: one that came too late left a gap, too."""
        return self._drops.lost

    @property
    def samples(self) -> int:
        """Rows of the force log."""
        return 0 if self._rows is None else self._rows.rows

    @property
    def bytes(self) -> int:
        """In the files."""
        return sum(table.size for table in self._tables)

    @property
    def clock_sd(self) -> float:
        """s, of the lines that bring the force's stamps to the camera's clock; NaN before there are any."""
        clocks = [one for one in (self._camera, self._force) if one is not None]
        sds = [one.line.sd for one in clocks if one.timing.own and not one.timing.host]
        return math.hypot(*sds) if sds else 0.0

    @property
    def error(self) -> float:
        """s, the largest error of what is known of both clocks beforehand."""
        force = 0.0 if self._force is None else self._force.timing.delay_error
        return self._camera.timing.delay_error + force

    def see(self, item: Frame | Samples) -> None:
        """What a stamp and its arrival say of the clocks."""
        if isinstance(item, Frame):
            self._camera.add(item.stamp, item.arrival)
        elif self._force is not None and np.isfinite(item.stamp).any():
            self._force.add(float(np.nanmax(item.stamp)), item.arrival)  # rows that come together waited for the newest

    def begin(self, places: RecordingPlaces, first: Frame) -> None:
        """Make the files of a film that begins with `first`. Raises `OSError` where they cannot be."""
        self._first = float(self._camera.own(first.stamp, first.arrival))
        self._stamps = GrowingTable(places.stamps, STAMP_COLUMNS)
        if places.log is not None:
            self._rows = GrowingTable(places.log, ("time_s", *self._columns, *ADDED))

    def frame(self, frame: Frame) -> float | None:
        """The time of a frame in the film, s; None where it came after a newer one."""
        own = float(self._camera.own(frame.stamp, frame.arrival))
        time = own - self._first
        if not time > self._last_frame:
            return None
        self._drops.see(frame.number, own)
        self._last_frame = time
        if self._stamps is not None:
            row = np.array([[time, frame.number, frame.stamp, frame.arrival]])
            self._stamps.add(row, (_TIME, "%d", _TIME, _TIME))
        return time

    def rows(self, samples: Samples) -> Array:
        """(n,) s, the film's clock, of rows of the force, as well as it is known by now; and put them into the log."""
        assert self._force is not None
        arrival = np.full(len(samples.stamp), samples.arrival)
        time = self._on_film(self._force.host(samples.stamp, arrival))
        self.lost_samples += samples.lost
        if self._rows is not None and len(time):
            steps = _LATE_ROW * np.arange(len(time))
            written = np.maximum.accumulate(np.maximum(time - steps, self._last_row + _LATE_ROW)) + steps
            self._last_row = float(written[-1])
            self._rows.add(
                np.column_stack([written, samples.force, samples.stamp, arrival]),
                (_TIME, *(_VALUE for _ in self._columns), _TIME, _TIME),
            )
            self._kept.append(np.column_stack([samples.stamp, arrival]))
        return time

    def flush(self) -> None:
        """Put what waits into the files. Raises `OSError`."""
        for table in self._tables:
            table.flush()

    def finish(self) -> None:
        """Close the files, and write the log anew with what all stamps together say of the clocks.

        Raises:
            OSError: what is in the files by then stays.
        """
        for table in self._tables:
            table.close()
        if self._rows is None or self._force is None or not self._kept:
            return
        self._camera.renew()
        self._force.renew()
        own, arrival = np.concatenate(self._kept).T
        retimed(self._rows.path, self._on_film(self._force.host(own, arrival)))

    def _on_film(self, host: Array) -> Array:
        return np.asarray(self._camera.from_host(host) - self._first)


# Frames and samples in the order in which they come in, from a camera and a sensor that are read beside each other.

_WAIT = 0.05  # s
_PATIENCE = 6.0  # s: FFmpeg may wait as long for a picture
_MOST_PICTURES = 24  # that wait, less than a second: beyond, the camera's own buffer has to hold them

Item = Frame | Samples | End
Source = CameraSource | ForceSource


class Pump:
    """Reads a camera and, where there is one, a force sensor until it is closed."""

    def __init__(self, camera: CameraSource, force: ForceSource | None, clock: Clock) -> None:
        """Both are open already."""
        self._sources: list[Source] = [camera, *([] if force is None else [force])]
        self._clock = clock
        self.at_will = isinstance(clock, sources.PlayedClock)  # else what is played comes as from a camera, by threads
        self._played = self.at_will and all(isinstance(source, sources.Played) for source in self._sources)
        self._ended: set[int] = set()
        self._pictures: queue.Queue[None] = queue.Queue(_MOST_PICTURES)
        self._items: queue.SimpleQueue[tuple[Source, Item]] = queue.SimpleQueue()
        self._stop = threading.Event()
        read = [] if self._played else self._sources
        self._threads = [threading.Thread(target=self._read, args=(one,), daemon=True) for one in read]
        for thread in self._threads:
            thread.start()

    @property
    def waiting(self) -> int:
        """Pictures that came and are not taken."""
        return self._pictures.qsize()

    def __iter__(self) -> Iterator[tuple[Source, Item] | None]:
        """What comes in, with the source that it is from; None where nothing came for a while."""
        while not self._stop.is_set():
            if self._played:
                item = self._next_played()
                if item is None:
                    return
                yield item
            else:
                try:
                    source, got = self._items.get(timeout=_WAIT)
                except queue.Empty:
                    yield None
                    continue
                if isinstance(got, Frame):
                    with suppress(queue.Empty):
                        self._pictures.get_nowait()
                yield source, got

    def close(self) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join(timeout=_PATIENCE)

    def _next_played(self) -> tuple[Source, Item] | None:
        """Of the sources that are played the item that comes first: always in the same order."""
        left = [(i, one) for i, one in enumerate(self._sources) if i not in self._ended]
        if not left:
            return None
        i, source = min(left, key=lambda one: (one[1].due(), one[0]))  # type: ignore[union-attr]
        item = source.read(float("inf"))
        if item is None or isinstance(item, End):
            self._ended.add(i)
        if item is None and len(left) > 1:  # it has nothing, and ends without a word
            return self._next_played()
        return source, item if item is not None else End(f"{source.name} ended")

    def _read(self, source: Source) -> None:
        while not self._stop.is_set():
            item = source.read(_WAIT)
            if item is None:
                continue
            while isinstance(item, Frame) and not self._stop.is_set():
                with suppress(queue.Full):
                    self._pictures.put(None, timeout=_WAIT)
                    break
            self._items.put((source, item))
            if isinstance(item, End):
                return
