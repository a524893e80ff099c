"""A RealSense camera, in place of `pyrealsense2`: the calls and numbers of its API reference. The layout of the
pictures (`uint16`, luma in the low byte) is what the package gives for a device of its own software."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from onebend import extras
from onebend.errors import MissingPackageError, RecordingError
from onebend.live.cameras import CameraSettings, RealSenseCamera
from onebend.live.sources import End, Frame, HostClock
from onebend.live.specs import camera_of

WIDTH, HEIGHT = 8, 4
OPTIONS = ("global_time_enabled", "emitter_enabled", "enable_auto_exposure", "exposure")


class Sensor:
    """One of a camera's sensors, with its streams."""

    def __init__(self, *streams: str, able: tuple[str, ...] = OPTIONS) -> None:
        self.streams, self.able, self.set = streams, able, dict[str, float]()

    def get_stream_profiles(self) -> list[Any]:
        return [SimpleNamespace(stream_type=lambda one=one: one) for one in self.streams]

    def supports(self, option: str) -> bool:
        return option in self.able

    def set_option(self, option: str, value: float) -> None:
        self.set[option] = value


class Picture:
    """A video frame."""

    def __init__(self, count: int, infrared: bool) -> None:
        self.count, self.infrared = count, infrared

    def get_data(self) -> Any:
        luma = np.arange(WIDTH * HEIGHT).reshape(HEIGHT, WIDTH) + self.count
        return luma.astype(np.uint8) if self.infrared else luma.astype(np.uint16) + (128 << 8)

    def get_timestamp(self) -> float:
        return 1000.0 + 33.25 * self.count  # ms

    def get_frame_number(self) -> int:
        return 7 + self.count


class Pipeline:
    """`pyrealsense2.pipeline` of one camera, whose cable is pulled after its last picture."""

    pictures = 3
    sensors: tuple[Sensor, ...] = ()

    def start(self, config: Any) -> Any:
        if config.serial not in ("", "0123"):
            raise RuntimeError("No device connected")
        self.count, self.infrared, self.stopped = 0, config.asked[0] == "infrared", False
        self.asked = config.asked
        return SimpleNamespace(get_device=lambda: SimpleNamespace(query_sensors=lambda: list(self.sensors)))

    def try_wait_for_frames(self, timeout_ms: int) -> tuple[bool, Any]:
        assert isinstance(timeout_ms, int)
        assert timeout_ms >= 1
        if self.count == self.pictures:
            raise RuntimeError("Frame didn't arrive: device disconnected")
        picture = Picture(self.count, self.infrared)
        self.count += 1
        return True, SimpleNamespace(get_color_frame=lambda: picture, get_infrared_frame=lambda _: picture)

    def stop(self) -> None:
        self.stopped = True


class Config:
    """`pyrealsense2.config`."""

    serial = ""

    def enable_device(self, serial: str) -> None:
        self.serial = serial

    def enable_stream(self, *asked: Any) -> None:
        self.asked = asked


@pytest.fixture
def sensors(monkeypatch: pytest.MonkeyPatch) -> tuple[Sensor, Sensor]:
    """Stereo and colour, of a camera that is plugged in."""
    made = ModuleType("pyrealsense2")
    there = Sensor("depth", "infrared"), Sensor("color", able=("global_time_enabled", *OPTIONS[2:]))
    monkeypatch.setattr(Pipeline, "sensors", there)
    names: dict[str, Any] = {
        "pipeline": Pipeline,
        "config": Config,
        "stream": SimpleNamespace(color="color", infrared="infrared"),
        "format": SimpleNamespace(yuyv="yuyv", y8="y8"),
        "option": SimpleNamespace(**{name: name for name in OPTIONS}),
    }
    vars(made).update(names)
    monkeypatch.setitem(sys.modules, "pyrealsense2", made)
    return there


def test_its_colour_pictures_with_the_cameras_own_stamps(sensors: tuple[Sensor, Sensor]) -> None:
    camera: Any = camera_of("realsense:0123,size=8x4,fps=30,exposure_ms=5")
    camera.open(HostClock())
    pipeline = camera._pipeline
    assert pipeline.asked == ("color", 8, 4, "yuyv", 30)
    assert sensors[0].set == {"global_time_enabled": 0.0, "emitter_enabled": 0.0}
    assert sensors[1].set == {"global_time_enabled": 0.0, "enable_auto_exposure": 0.0, "exposure": 50.0}  # 100 us each
    frames = [camera.read(0.1) for _ in range(3)]
    assert [one.number for one in frames] == [7, 8, 9]
    assert [one.stamp for one in frames] == pytest.approx([1.0, 1.03325, 1.0665])
    assert frames[1].picture.tolist() == (np.arange(32).reshape(4, 8) + 1).tolist()
    assert frames[1].colour.to_ndarray(format="gray").shape == (4, 8)
    gone = camera.read(0.1)
    assert isinstance(gone, End)
    assert gone.fault
    assert "its cable was pulled" in gone.why
    camera.close()
    assert pipeline.stopped
    camera.close()  # twice does no harm


def test_its_infrared_pictures_without_the_pattern(sensors: tuple[Sensor, Sensor]) -> None:
    camera = camera_of("realsense:any,stream=infrared,size=8x4,exposure_ms=5")
    camera.open(HostClock())
    assert sensors[0].set["exposure"] == 5000.0  # us
    assert sensors[0].set["emitter_enabled"] == 0.0
    assert "exposure" not in sensors[1].set
    frame = camera.read(0.1)
    assert isinstance(frame, Frame)
    assert frame.colour is None
    assert frame.picture.tolist() == np.arange(32).reshape(4, 8).tolist()


def test_what_is_not_there_is_refused_in_words(sensors: tuple[Sensor, Sensor], monkeypatch: pytest.MonkeyPatch) -> None:
    assert sensors
    with pytest.raises(RecordingError, match="camera 999 gives no color pictures of 1280x720 at 30 Hz"):
        camera_of("realsense:999").open(HostClock())
    with pytest.raises(RecordingError, match="stream=depth: take one of color, infrared"):
        camera_of("realsense:any,stream=depth")
    with pytest.raises(RecordingError, match="size=big: write width and height in pixels"):
        camera_of("realsense:any,size=big")
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(MissingPackageError, match=r"needs the package pyrealsense2.*onebend\[realsense\]"):
        camera_of("realsense:any").open(HostClock())

    def without_usb(_name: str) -> Any:
        raise ImportError("libusb-1.0.so.0: cannot open shared object file")

    monkeypatch.setattr(extras, "import_module", without_usb)
    with pytest.raises(MissingPackageError, match="pyrealsense2 does not load: libusb"):
        RealSenseCamera("", CameraSettings()).open(HostClock())


def test_a_camera_that_falls_silent_ends(sensors: tuple[Sensor, Sensor], monkeypatch: pytest.MonkeyPatch) -> None:
    assert sensors

    class Hand(HostClock):
        passed = 0.0

        def now(self) -> float:
            return self.passed

    monkeypatch.setattr(Pipeline, "try_wait_for_frames", lambda *_: (False, None))
    clock, camera = Hand(), camera_of("realsense:any")
    camera.open(clock)
    assert camera.read(0.1) is None
    clock.passed = 6.0
    silent = camera.read(0.1)
    assert isinstance(silent, End)
    assert "sends no pictures any more" in silent.why
