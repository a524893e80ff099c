"""A camera that answers as the kernel's documentation says, in place of one."""

from __future__ import annotations

import errno
import mmap
import os
import struct
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from onebend.errors import RecordingError
from onebend.live import cameras as v4l2
from onebend.live.cameras import CameraSettings, V4l2Camera
from onebend.live.sources import End, Frame, HostClock
from onebend.live.specs import camera_of

WIDTH, HEIGHT = 64, 48
RAMP = np.tile(np.linspace(20, 230, WIDTH), (HEIGHT, 1)).astype(np.uint8)


def jpeg() -> bytes:
    packed = BytesIO()
    Image.fromarray(np.stack([RAMP] * 3, axis=-1)).save(packed, "JPEG", quality=95)
    return packed.getvalue()


def yuyv() -> bytes:
    return np.stack([RAMP, np.full_like(RAMP, 128)], axis=-1).tobytes()


class FakeCamera(v4l2.Kernel):
    """The calls that V4L2 knows. Pictures wait in `coming`: their bytes, stamps [s], numbers and flags."""

    def __init__(self, packed: str = "MJPG", *, monotonic: bool = True) -> None:
        self.packed, self.monotonic, self.streaming = packed, monotonic, False
        self.coming: list[tuple[bytes, float, int, int]] = []
        self.buffers = [mmap.mmap(-1, 65536) for _ in range(4)]
        self.queued: list[int] = []
        self.controls: dict[int, int] = {}
        self.rate = (0, 0)
        self.capabilities = v4l2.CAN_CAPTURE | v4l2.CAN_STREAM
        self.gone = 0  # an errno

    def open(self, path: Path) -> int:
        if path.name != "video0":
            raise OSError(errno.ENOENT, "No such file or directory")
        return 7

    def close(self, handle: int) -> None:
        assert handle == 7

    def map(self, handle: int, length: int, offset: int) -> mmap.mmap:
        assert (handle, length) == (7, 65536)
        return self.buffers[offset // 65536]

    def ready(self, handle: int, wait: float) -> bool:
        assert handle == 7
        assert wait >= 0.0
        return bool(self.coming and self.queued) or bool(self.gone)

    def ioctl(self, handle: int, request: int, data: bytearray) -> None:
        assert handle == 7
        assert request >> 16 & 0x3FFF == len(data), "the request says how long its data are"
        if self.gone:
            raise OSError(self.gone, os.strerror(self.gone))
        calls = {
            v4l2.QUERYCAP: self._able, v4l2.S_FMT: self._form, v4l2.REQBUFS: self._count, v4l2.QUERYBUF: self._where,
            v4l2.QBUF: self._queue, v4l2.DQBUF: self._give, v4l2.STREAMON: self._on, v4l2.STREAMOFF: self._on,
            v4l2.S_PARM: self._pace, v4l2.S_CTRL: self._control,
        }  # fmt: skip
        calls[request](data)

    def _able(self, data: bytearray) -> None:
        struct.pack_into("<II", data, 84, self.capabilities | v4l2.OWN_CAPABILITIES, self.capabilities)

    def _form(self, data: bytearray) -> None:
        struct.pack_into("<IIII", data, 8, WIDTH, HEIGHT, int.from_bytes(self.packed.encode(), "little"), 1)
        struct.pack_into("<II", data, 24, WIDTH * (2 if self.packed == "YUYV" else 1), 65536)

    def _pace(self, data: bytearray) -> None:
        self.rate = struct.unpack_from("<II", data, 12)

    def _control(self, data: bytearray) -> None:
        name, value = struct.unpack("<Ii", data)
        if name == v4l2.FOCUS_AUTO:
            raise OSError(errno.EINVAL, "Invalid argument")
        self.controls[name] = value

    def _count(self, data: bytearray) -> None:
        struct.pack_into("<I", data, 0, len(self.buffers))

    def _where(self, data: bytearray) -> None:
        [index] = struct.unpack_from("<I", data, 0)
        struct.pack_into("<I", data, 12, v4l2.MONOTONIC if self.monotonic else 0)
        struct.pack_into("<QI", data, 64, 65536 * index, 65536)

    def _queue(self, data: bytearray) -> None:
        index, kind = struct.unpack_from("<II", data, 0)
        assert (kind, struct.unpack_from("<I", data, 60)[0]) == (1, 1)
        self.queued.append(index)

    def _on(self, data: bytearray) -> None:
        assert struct.unpack("<i", data) == (1,)
        self.streaming = not self.streaming

    def _give(self, data: bytearray) -> None:
        picture, stamp, number, flags = self.coming.pop(0)
        index = self.queued.pop(0)
        self.buffers[index][: len(picture)] = picture
        struct.pack_into("<I", data, 0, index)
        struct.pack_into("<II", data, 8, len(picture), flags | v4l2.MONOTONIC)
        struct.pack_into("<qq", data, 24, int(stamp), round(stamp % 1 * 1e6))
        struct.pack_into("<I", data, 56, number)


def opened(fake: FakeCamera, settings: CameraSettings = CameraSettings()) -> V4l2Camera:
    camera = V4l2Camera(Path("/dev/video0"), settings, fake)
    camera.open(HostClock())
    return camera


@pytest.mark.parametrize(("packed", "data"), [("MJPG", jpeg()), ("YUYV", yuyv()), ("GREY", RAMP.tobytes())])
def test_pictures_come_with_the_kernels_stamps_and_count(packed: str, data: bytes) -> None:
    fake = FakeCamera(packed)
    camera = opened(fake, CameraSettings(packed=packed, exposure=0.004, fps=60.0))
    assert fake.streaming
    assert fake.rate == (1000, 60000)
    assert fake.controls == {v4l2.EXPOSURE_AUTO: 1, v4l2.EXPOSURE: 40}
    fake.coming = [(data, 12.25, 3, 0), (data, 12.283, 5, 0)]
    frames = [camera.read(0.1) for _ in range(2)]
    for frame, stamp, number in zip(frames, (12.25, 12.283), (3, 5), strict=True):
        assert isinstance(frame, Frame)
        assert frame.stamp == pytest.approx(stamp, abs=1e-6)
        assert frame.number == number
        assert frame.picture.shape == (HEIGHT, WIDTH)
        assert np.abs(frame.picture.astype(int) - RAMP).mean() < 3.0
        assert (frame.colour is None) == (packed == "GREY")
    assert camera.timing.host
    assert sorted(fake.queued) == [0, 1, 2, 3]  # each buffer went back
    assert camera.read(0.0) is None
    camera.close()
    assert not fake.streaming


def test_broken_pictures_are_left_out() -> None:
    fake = FakeCamera()
    camera = opened(fake)
    fake.coming = [(jpeg(), 1.0, 0, v4l2.BROKEN), (b"no picture", 1.1, 1, 0), (jpeg(), 1.2, 2, 0)]
    got = [camera.read(0.1) for _ in range(3)]
    assert [isinstance(one, Frame) for one in got] == [False, False, True]
    camera.close()


def test_another_clock_than_this_machines_is_followed() -> None:
    camera = opened(FakeCamera(monotonic=False))
    assert camera.timing.own
    assert not camera.timing.host
    camera.close()


def test_a_pulled_cable_ends_it() -> None:
    fake = FakeCamera()
    camera = opened(fake)
    fake.gone = errno.ENODEV
    got = camera.read(0.1)
    assert isinstance(got, End)
    assert got.fault
    assert "its cable was pulled" in got.why
    camera.close()


@pytest.mark.parametrize(
    ("number", "says"),
    [
        (errno.EBUSY, "another program has it"),
        (errno.EACCES, "usermod -aG video"),
        (errno.EIO, "cannot be used"),
    ],
)
def test_a_camera_that_refuses_says_what_to_do(number: int, says: str) -> None:
    fake = FakeCamera()
    fake.gone = number
    with pytest.raises(RecordingError, match=says):
        opened(fake)


def test_no_camera_and_the_wrong_one_are_told() -> None:
    with pytest.raises(RecordingError, match="there is no such camera"):
        V4l2Camera(Path("/dev/video9"), kernel=FakeCamera()).open(HostClock())
    fake = FakeCamera()
    fake.capabilities = v4l2.CAN_STREAM
    with pytest.raises(RecordingError, match="Try the other one"):
        opened(fake)
    with pytest.raises(RecordingError, match="packed as H264, and MJPG, YUYV, GREY, NV12 can be read"):
        opened(FakeCamera("H264"))


def test_the_spec_says_size_rate_and_exposure() -> None:
    camera = camera_of("/dev/video3,size=1920x1080,fps=60,packed=YUYV,exposure_ms=5")
    assert isinstance(camera, V4l2Camera)
    assert camera._settings == CameraSettings(1920, 1080, 60.0, 0.005, "YUYV")
    for spec, says in (
        ("size=big", "size=1280x720"),
        ("packed=H264", "take one of MJPG"),
        ("fps=0", "number from 0.1"),
    ):
        with pytest.raises(RecordingError, match=says):
            camera_of(f"/dev/video0,{spec}")
    with pytest.raises(RecordingError, match="there is no such camera"):
        camera_of("/dev/video99").open(HostClock())
