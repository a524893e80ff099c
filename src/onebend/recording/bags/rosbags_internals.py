"""Everything that onebend takes from the inside of rosbags: its decompressors. All else is its documented interface.

rosbags depends on one zstd and one lz4 library or another, by version of Python; its own table of them spares onebend
the choice.
"""

from __future__ import annotations

import bz2
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import version
from zlib import crc32

from onebend.errors import RecordingError
from onebend.recording.bags.items import BrokenOffError

VERSIONS = "rosbags>=0.11.9,<0.12"  # as in pyproject.toml: older ones lack names or miss damage
_TABLE = ("rosbags.rosbag2.storage_mcap", "DECOMPRESSORS")


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
    if compression == "bz2":
        return _guarded(lambda: bz2.decompress(packed))
    return _unpacked("" if compression == "none" else compression, packed, 0)


def _unpacked(compression: str, packed: bytes, size: int) -> bytes:
    table = _decompressors()
    if compression not in table:
        raise BrokenOffError(f"it is packed as {compression!r}, which is not known")
    return _guarded(lambda: table[compression](packed, size))


def _guarded(unpack: Callable[[], bytes]) -> bytes:
    """What `unpack` gives; its failure, of whichever library, is the file's."""
    try:
        return unpack()
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
