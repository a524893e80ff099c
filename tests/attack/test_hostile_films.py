"""Films that are none: lists of files, covers, pictures without bounds, damaged heads; tags that are not there."""

from __future__ import annotations

import io
import os
import re
import shutil
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from tests.attack.family import Case, Harm, edit, params, sparse, withstood, written
from tests.attack.hostile_films import CASES as HARD
from tests.attack.victim import Victim

FILM = "video.mp4"
TOML = "recording.toml"
SIZE = (640, 360)


def list_of_films(text: str) -> Harm:
    """A text that names the film, which lies beside it."""

    def harm(folder: Path) -> None:
        (folder / FILM).rename(folder / "real.mp4")
        (folder / FILM).write_text(text, encoding="utf-8")

    return harm


def encoded(count: int, kind: str = "mp4", last: int | None = None) -> Harm:
    """So many black pictures; the last one may come at another time [ms]."""

    def harm(folder: Path) -> None:
        black = np.zeros(SIZE[::-1], np.uint8)
        with av.open(str(folder / FILM), "w", format=kind) as container:
            stream = container.add_stream("libx264", rate=30)
            stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
            stream.codec_context.time_base = Fraction(1, 1000)
            for i in range(count):
                frame = av.VideoFrame.from_ndarray(black, format="gray").reformat(format="yuv420p")
                frame.pts = last if last is not None and i == count - 1 else 33 * i
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))

    return harm


def cover_alone(folder: Path) -> None:
    """A sound file with a picture on its cover."""
    jpeg = io.BytesIO()
    Image.fromarray(np.zeros((720, 1280, 3), np.uint8)).save(jpeg, format="JPEG")
    picture = b"\0image/jpeg\0\3\0" + jpeg.getvalue()
    frame = b"APIC" + len(picture).to_bytes(4, "big") + b"\0\0" + picture
    size = bytes((len(frame) >> shift) & 127 for shift in (21, 14, 7, 0))
    with av.open(str(folder / "sound.mp3"), "w") as container:
        stream = container.add_stream("mp3", rate=44100)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 88200), np.int16), layout="mono", format="s16p")
        sound.sample_rate = 44100
        container.mux(stream.encode(sound))
        container.mux(stream.encode(None))
    (folder / FILM).write_bytes(b"ID3\3\0\0" + size + frame + (folder / "sound.mp3").read_bytes())


def cover_first(folder: Path) -> None:
    """The film, with a cover picture before it."""
    with av.open(str(folder / FILM)) as film, av.open(str(folder / "covered.mkv"), "w") as container:
        cover = container.add_stream("mjpeg", rate=1)
        cover.width, cover.height, cover.pix_fmt = 320, 180, "yuvj420p"
        cover.disposition = av.stream.Disposition.attached_pic
        copied = container.add_stream_from_template(film.streams.video[0])
        container.mux(cover.encode(av.VideoFrame.from_ndarray(np.zeros((180, 320, 3), np.uint8), format="rgb24")))
        container.mux(cover.encode(None))
        for packet in film.demux(film.streams.video[0]):
            if packet.dts is not None:
                packet.stream = copied
                container.mux(packet)
    shutil.move(folder / "covered.mkv", folder / FILM)


def still(kind: str) -> Harm:
    return lambda folder: Image.fromarray(np.zeros(SIZE[::-1], np.uint8)).save(folder / FILM, format=kind)


def spoilt(head: bool) -> Harm:
    """Bytes of the head, or of the pictures, exchanged for others."""

    def harm(folder: Path) -> None:
        content = bytearray((folder / FILM).read_bytes())
        begin = content.find(b"moov")
        random = np.random.default_rng(1)
        low, high, count = (begin, len(content), 200) if head else (5000, len(content) - 20_000, 50)
        for place in random.integers(low, high, count):
            content[place] = int(random.integers(256))
        (folder / FILM).write_bytes(bytes(content))

    return harm


def big_pictures(folder: Path) -> None:
    (folder / FILM).write_bytes(b"YUV4MPEG2 W16000 H16000 F30:1 Ip A1:1 C420\nFRAME\n")
    os.truncate(folder / FILM, 2**33)


def half(folder: Path) -> None:
    os.truncate(folder / FILM, (folder / FILM).stat().st_size // 2)


M3U8 = "#EXTM3U\n#EXT-X-TARGETDURATION:20\n#EXTINF:18,\nreal.mp4\n#EXT-X-ENDLIST\n"
SDP = "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 RTP/AVP 96\na=rtpmap:96 H264/90000\n"
UNSEEN = "tag 7 is in none of 20 frames; seen: 0, 1, 2, 3"
NO_FILM = "is not a readable video|holds no film"
CASES = [
    Case("a playlist", list_of_films(M3U8), NO_FILM),
    Case("a playlist of /etc/passwd", list_of_films(M3U8.replace("real.mp4", "file:///etc/passwd")), NO_FILM),
    Case("a list of films", list_of_films("ffconcat version 1.0\nfile real.mp4\nfile real.mp4\n"), NO_FILM),
    Case("a session on the network", written(FILM, SDP), NO_FILM),
    Case("an address", edit(TOML, '"video.mp4"', '"http://127.0.0.1:9/x.mp4"'), "there is no file"),
    Case("a protocol", edit(TOML, '"video.mp4"', '"concat:a|b"'), "there is no file"),
    Case("a made-up source", edit(TOML, '"video.mp4"', '"testsrc=size=640x480"'), "there is no file"),
    Case("text", written(FILM, "hello\n" * 1000), NO_FILM),
    Case("empty", written(FILM, ""), "is empty"),
    Case("a GIF", still("GIF"), NO_FILM),
    Case("a PNG", still("PNG"), NO_FILM),
    Case("a cover alone", cover_alone, NO_FILM),
    Case("a cover before the film", cover_first, passes=True),
    Case("one picture", encoded(1), "in any of the 1 frames.*there are 1 frames"),
    Case("black pictures", encoded(60), "no tag of recording.toml is in any"),
    Case("a last picture after 11 days", encoded(40, "matroska", last=10**9), "no tag of recording.toml"),
    Case("pictures of 256 megapixels", big_pictures, "are larger than can be read"),
    Case("a sparse film", sparse(FILM, 2**33), passes=True),
    Case("cut in half", half, NO_FILM),
    Case("a damaged head", spoilt(head=True), "is not a readable video|damaged|no film|does not rise|has no time"),
    Case("damaged pictures", spoilt(head=False), "damaged or truncated"),
    Case("the kernel's messages", edit(TOML, '"video.mp4"', '"/proc/kmsg"'), "is empty"),
    Case("an endless device", edit(TOML, '"video.mp4"', '"/dev/zero"'), "is a device, and no file"),
    Case("a tag that is not there", edit(TOML, "id = 3\n", "id = 7\n"), UNSEEN),
    Case("a tag that no family has", edit(TOML, "id = 3\n", "id = 587\n"), "no tag 587 in tag36h11"),
    Case("another family", edit(TOML, '"tag36h11"', '"tag25h9"'), r"look like tag36h11 \(ids 0, 1, 2, 3\)"),
]
QUICK = {"a list of films", "pictures of 256 megapixels", "a tag that is not there"}
QUICK_HARD = {"a pipe", "a circle of links", "two sizes in one film", "every packet twice"}


@pytest.mark.parametrize("case", params(CASES, QUICK))
def test_a_film(victim: Victim, film: Path, case: Case) -> None:
    case.harm(film)
    withstood(victim.attack(["check", "rec"], film.parent), case, seconds=40.0)


@pytest.mark.parametrize("case", params(HARD, QUICK_HARD))
def test_a_film_that_is_hard_to_read(victim: Victim, film: Path, case: Case) -> None:
    case.harm(film)
    outcome = victim.attack(["check", "rec"], film.parent)
    withstood(outcome, case, seconds=40.0)
    assert re.search(case.words, " ".join(outcome.err.split()))
