"""Films made to be hard to read: cut, spoilt, of odd pixels, sizes and times, or no files at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from PIL import Image

from tests.attack.family import Case, Harm

FILM = "video.mp4"
HEAD = 40  # frames that are kept of a film that is written anew


def frames(path: Path, most: int = HEAD) -> Iterator[av.VideoFrame]:
    """Every tenth picture of a film, so that the push is among them."""
    with av.open(str(path)) as film:
        for i, frame in enumerate(film.decode(video=0)):
            if i % 10 == 0:
                yield frame
            if i >= 10 * most:
                return


def anew(codec: str, pixels: str, kind: str = "matroska", **options: str) -> Harm:
    """The same pictures by another codec, in other pixels."""

    def harm(folder: Path) -> None:
        with av.open(str(folder / "new"), "w", format=kind) as out:
            stream: Any = out.add_stream(codec, rate=3, options=options)
            for i, frame in enumerate(frames(folder / FILM)):
                if i == 0:
                    stream.width, stream.height, stream.pix_fmt = frame.width, frame.height, pixels
                picture = frame.reformat(format=pixels)
                picture.pts, picture.time_base = i, Fraction(1, 3)
                out.mux(stream.encode(picture))
            out.mux(stream.encode(None))
        (folder / "new").replace(folder / FILM)

    return harm


def repacked(change: Callable[[list[Any]], list[Any]], kind: str = "matroska", **options: str) -> Harm:
    """The film's own packets, changed, in another container."""

    def harm(folder: Path) -> None:
        with (
            av.open(str(folder / FILM)) as film,
            av.open(str(folder / "new"), "w", format=kind, container_options=options) as out,
        ):
            stream = out.add_stream_from_template(film.streams.video[0])
            packets = [one for one in film.demux(film.streams.video[0]) if one.dts is not None]
            for packet in change(packets):
                packet.stream = stream
                out.mux(packet)
        (folder / "new").replace(folder / FILM)

    return harm


def two_sizes(folder: Path) -> None:
    """JPEGs of one size, then of another."""
    with av.open(str(folder / "new"), "w", format="matroska") as out:
        stream = out.add_stream("mjpeg", rate=3)
        stream.width, stream.height, stream.pix_fmt = 1280, 720, "yuvj420p"
        for i in range(20):
            size = (1280, 720) if i < 10 else (640, 360)
            Image.new("RGB", size).save(folder / "one.jpg")
            packet = av.Packet((folder / "one.jpg").read_bytes())
            packet.pts = packet.dts = 333 * i
            packet.time_base, packet.stream, packet.is_keyframe = Fraction(1, 1000), stream, True
            out.mux(packet)
    (folder / "new").replace(folder / FILM)


def sound(folder: Path) -> None:
    """An MP4 of sound alone."""
    with av.open(str(folder / FILM), "w", format="mp4") as out:
        stream = out.add_stream("aac", rate=44100)
        heard = av.AudioFrame.from_ndarray(np.zeros((1, 44100), np.float32), layout="mono", format="fltp")
        heard.sample_rate = 44100
        out.mux(stream.encode(heard))
        out.mux(stream.encode(None))


def no_pictures(folder: Path) -> None:
    """A track of pictures without one."""
    with av.open(str(folder / FILM), "w", format="matroska") as out:
        stream = out.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 640, 360, "yuv420p"
        out.start_encoding()


def patched(box: bytes, at: int, value: bytes) -> Harm:
    """Bytes in a box of the MP4 exchanged, counted from behind its name."""

    def harm(folder: Path) -> None:
        content = bytearray((folder / FILM).read_bytes())
        place = content.rfind(box)
        assert place > 0, box
        content[place + len(box) + at : place + len(box) + at + len(value)] = value
        (folder / FILM).write_bytes(bytes(content))

    return harm


def turned(folder: Path) -> None:
    """A display matrix that turns the picture by 90 degrees."""
    one, zero = (1 << 16).to_bytes(4, "big"), bytes(4)
    minus, last = (2**32 - (1 << 16)).to_bytes(4, "big"), (1 << 30).to_bytes(4, "big")
    patched(b"tkhd", 40, b"".join([zero, one, zero, minus, zero, zero, zero, zero, last]))(folder)


def cut(share: float) -> Harm:
    def harm(folder: Path) -> None:
        os.truncate(folder / FILM, int(share * (folder / FILM).stat().st_size))

    return harm


def spoilt_end(folder: Path) -> None:
    """The last fifth of the pictures is noise; the head is whole."""
    repacked(lambda packets: packets, "mp4", movflags="faststart")(folder)
    content = bytearray((folder / FILM).read_bytes())
    first = int(0.8 * len(content))
    content[first:] = np.random.default_rng(3).integers(0, 256, len(content) - first, dtype=np.uint8).tobytes()
    (folder / FILM).write_bytes(bytes(content))


def backwards(folder: Path) -> None:
    """A Matroska file whose last cluster of pictures says that it is its first in time."""
    repacked(lambda packets: packets)(folder)
    content = bytearray((folder / FILM).read_bytes())
    time = content.find(b"\xe7", content.rfind(b"\x1f\x43\xb6\x75"))
    size = content[time + 1] & 0x7F
    content[time + 2 : time + 2 + size] = bytes(size)
    (folder / FILM).write_bytes(bytes(content))


def every_one_twice(packets: list[Any]) -> list[Any]:
    return [one for packet in packets for one in (packet, packet)]


def instead(make: Callable[[Path], object]) -> Harm:
    def harm(folder: Path) -> None:
        (folder / FILM).unlink()
        make(folder / FILM)

    return harm


def jpeg(kind: str) -> Harm:
    return lambda folder: Image.new("RGB", (640, 360)).save(folder / FILM, format=kind)


def folder_of_films(film: Path) -> None:
    film.mkdir()
    shutil.copy(film.parent / "recording.toml", film / "one.mp4")


NONE = "is not a readable video|holds no film|holds no picture|no picture|damaged or truncated"
CASES = [
    Case("cut short, its head first", lambda f: (repacked(lambda p: p, "mp4", movflags="faststart")(f), cut(0.5)(f))),
    Case("a track without a picture", no_pictures, NONE),
    Case("two sizes in one film", two_sizes, "size"),
    Case("times that go back", backwards, "does not rise"),
    Case("every packet twice", repacked(every_one_twice), "does not rise|twice|repeat"),
    Case("16 bits of grey", anew("ffv1", "gray16le"), passes=True),
    Case("8 bits of grey", anew("ffv1", "gray"), passes=True),
    Case("10 bits", anew("ffv1", "yuv420p10le"), passes=True),
    Case("with transparency", anew("png", "rgba", "mov"), passes=True),
    Case("colours of 16 bits", anew("png", "rgb48be", "mov"), passes=True),
    Case("a palette", anew("png", "monob", "mov"), passes=True),
    Case("65535 pixels by 65535 in the track", patched(b"tkhd", 76, b"\xff\xff\0\0\xff\xff\0\0"), passes=True),
    Case("65535 pixels by 65535 in the codec", patched(b"avc1", 24, b"\xff\xff\xff\xff"), passes=True),
    Case("a thousand million pictures", patched(b"stsz", 8, (10**9).to_bytes(4, "big")), NONE),
    Case("four thousand million times", patched(b"stts", 4, b"\xff\xff\xff\xff"), NONE),
    Case("a film of a thousand years", patched(b"mdhd", 16, b"\x7f\xff\xff\xff"), passes=True),
    Case("turned by its display matrix", turned, "calibrated for pictures of 1280 x 720, the video has 720 x 1280"),
    Case("sound alone", sound, NONE),
    Case("a JPEG", jpeg("JPEG"), NONE),
    Case("a WebP", jpeg("WEBP"), NONE),
    Case("a TIFF", jpeg("TIFF"), NONE),
    Case("a spoilt end", spoilt_end, "damaged or truncated"),
    Case("a pipe", instead(os.mkfifo), "is a pipe, and no file"),
    Case("a circle of links", instead(lambda film: film.symlink_to(film.name)), "is a link that leads nowhere"),
    Case("a link to a device", instead(lambda film: film.symlink_to("/dev/zero")), "is a device, and no file"),
    Case("a link to a terminal", instead(lambda film: film.symlink_to("/dev/tty")), "is a device, and no file"),
    Case("a folder", instead(folder_of_films), "is a folder, and no file"),
]
