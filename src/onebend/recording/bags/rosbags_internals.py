"""Everything that onebend takes from the inside of rosbags: its decompressors. All else is its documented interface.

rosbags depends on one zstd and one lz4 library or another, by version of Python; its own names for them spare onebend
the choice. They unpack whatever they are given, to any size. `bounded_readers` puts others in their place, which stop
where a chunk, or a whole reading, grows beyond what a film or a log comes to.
"""

from __future__ import annotations

import bz2
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Protocol
from zlib import crc32

from onebend.errors import RecordingError
from onebend.extras import require
from onebend.recording.bags.items import BrokenOffError

VERSIONS = "rosbags>=0.11.9,<0.12"  # as in pyproject.toml: older ones lack names or miss damage
_TABLE = ("rosbags.rosbag2.storage_mcap", "DECOMPRESSORS")
MOST_CHUNK = 2**28  # bytes that one chunk or message may unpack to
MOST_READ, MOST_GAIN = 2**28, 200  # of one reading: bytes whatever the file's size, and times that size
STEP = 2**20  # bytes unpacked at a time


class _Unpacker(Protocol):
    """What zstd, lz4 and bz2 have in common."""

    @property
    def eof(self) -> bool: ...

    @property
    def unused_data(self) -> bytes: ...

    def decompress(self, data: bytes, max_length: int) -> bytes: ...


class ReadingBudget:
    """How much the reading of one file may still unpack."""

    def __init__(self) -> None:
        self.left = float(MOST_READ)

    def renew(self, files: list[Path]) -> None:
        """Begin a reading of the files."""
        self.left = MOST_READ + MOST_GAIN * float(sum(file.stat().st_size for file in files if file.is_file()))

    def take(self, count: int) -> None:
        """Count bytes that were unpacked.

        Raises:
            BrokenOffError: they are more than any film or log comes to.
        """
        self.left -= count
        if self.left < 0.0:
            raise BrokenOffError("it unpacks to far more than a film or a log comes to")


BUDGET = ReadingBudget()


def bounded_readers(files: list[Path]) -> None:
    """Have rosbags unpack no more than one reading of `files` may come to.

    Raises:
        MissingPackageError: rosbags is not installed.
    """
    require(("rosbags",), "ros")
    BUDGET.renew(files)
    table = _decompressors()
    table.update({kind: _bounded_mcap(kind) for kind in ("", "zstd", "lz4")})
    ros1 = getattr(import_module("rosbags.rosbag1.reader"), "decompressors", {})
    ros1.update({kind: lambda data, kind=kind: unpack(kind, data) for kind in ("bz2", "lz4") if kind in ros1})
    reader: Any = import_module("rosbags.rosbag2.reader")
    if not isinstance(reader.zstd, SimpleNamespace):
        reader.zstd = SimpleNamespace(
            decompress=lambda data: unpack("zstd", data), open=_bounded_open(reader.zstd.open)
        )


def _bounded_mcap(kind: str) -> Callable[[bytes, int], bytes]:
    return lambda data, size: unpack(kind, data, min(size, MOST_CHUNK) if size else MOST_CHUNK)


def _bounded_open(opened: Callable[..., Any]) -> Callable[..., Any]:
    """zstd's `open`, whose files count what is read of them."""

    def instead(*arguments: Any) -> Any:
        stream = opened(*arguments)
        read = stream.read

        def counted(size: int = -1) -> bytes:
            data: bytes = read(STEP if size < 0 else min(size, STEP))
            BUDGET.take(len(data))
            return data

        stream.read = counted
        return stream

    return instead


def unpack(kind: str, packed: bytes, most: int = MOST_CHUNK) -> bytes:
    """What `packed` holds, at most `most` bytes; `kind` is "" (not packed), "zstd", "lz4" or "bz2".

    Raises:
        BrokenOffError: it holds more, or the reading has come to more than it may.
    """
    if not kind:
        BUDGET.take(len(packed))
        return packed
    parts, size, data, one = [], 0, packed, _unpacker(kind)
    while True:
        part = one.decompress(data, STEP)
        data = b""
        size += len(part)
        BUDGET.take(len(part))
        if size > most:
            raise BrokenOffError(f"it unpacks to more than the {most} bytes that it may")
        parts.append(part)
        if one.eof and one.unused_data:  # several frames, one after the other
            data, one = one.unused_data, _unpacker(kind)
        elif one.eof:
            return b"".join(parts)
        elif not part:
            raise BrokenOffError("it is cut off")


def _unpacker(kind: str) -> _Unpacker:
    made: _Unpacker
    if kind == "zstd":
        made = import_module(_TABLE[0]).zstd.ZstdDecompressor()
    elif kind == "lz4":
        made = import_module("lz4.frame").LZ4FrameDecompressor()
    else:
        made = bz2.BZ2Decompressor()
    return made


def unpack_zstd(packed: bytes) -> bytes:
    """A message that its recorder packed for itself.

    Raises:
        BrokenOffError: it cannot be unpacked.
    """
    return _unpacked("zstd", packed, 0)


def unpack_mcap_chunk(packed: bytes, compression: str, size: int, checksum: int) -> bytes:
    """The records inside a chunk of an MCAP file; its `size` [bytes] and its CRC-32 (0: none) must hold.

    Raises:
        BrokenOffError: it cannot be unpacked, or is not what was packed.
    """
    content = _unpacked(compression, packed, size)
    if len(content) != size:
        raise BrokenOffError(f"it holds {len(content)} bytes and says that it has {size}")
    if checksum and crc32(content) != checksum:
        raise BrokenOffError("its checksum does not hold")
    return content


def unpack_ros1_chunk(packed: bytes, compression: str) -> bytes:
    """The records inside a chunk of a ROS 1 bag.

    Raises:
        BrokenOffError: it cannot be unpacked.
    """
    if compression not in ("none", "bz2", "lz4"):
        raise BrokenOffError(f"it is packed as {compression!r}, which is not known")
    return _guarded(lambda: unpack("" if compression == "none" else compression, packed))


def _unpacked(compression: str, packed: bytes, size: int) -> bytes:
    if compression not in _decompressors():
        raise BrokenOffError(f"it is packed as {compression!r}, which is not known")
    return _guarded(lambda: unpack(compression, packed, min(size, MOST_CHUNK) if size else MOST_CHUNK))


def _guarded(unpacked: Callable[[], bytes]) -> bytes:
    """What `unpacked` gives; its failure, of whichever library, is the file's."""
    try:
        return unpacked()
    except BrokenOffError:
        raise
    except Exception as wrong:  # zstd, lz4 and bz2 each have an error of their own, or a RuntimeError
        raise BrokenOffError(f"it cannot be unpacked ({wrong})") from None


def _decompressors() -> dict[str, Callable[[bytes, int], bytes]]:
    """By compression ("": none): what unpacks bytes to a size, where that is known.

    Raises:
        RecordingError: the installed rosbags has no such table.
    """
    module, name = _TABLE
    try:
        table: dict[str, Callable[[bytes, int], bytes]] = getattr(import_module(module), name)
    except (ImportError, AttributeError):
        raise RecordingError(
            f"rosbags {version('rosbags')} lacks {module}.{name}, without which a bag cannot be read from front to "
            f"back. Install a version that onebend knows: pip install '{VERSIONS}'"
        ) from None
    return table
