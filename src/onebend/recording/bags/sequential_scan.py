"""Robot logs (MCAP, ROS 1 bag, sqlite3) read from front to back without their index, up to where a cut or damaged one
breaks off."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from onebend.recording.bags.items import BrokenOffError, Channel, Item
from onebend.recording.bags.rosbags_internals import unpack_mcap_chunk, unpack_ros1_chunk, unpack_zstd
from onebend.recording.bags.sqlite_pages import SQLITE_MAGIC, scan_sqlite

MCAP_MAGIC = b"\x89MCAP0\r\n"
ROS1_MAGIC = b"#ROSBAG V2.0\n"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # no message begins so: CDR begins with a zero
SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 3, 4, 5, 6, 15  # records of MCAP
ROS1_MESSAGE, ROS1_HEADER, ROS1_CHUNK, ROS1_CHUNK_INFO, ROS1_CONNECTION = 2, 3, 5, 6, 7


def scan(path: Path) -> Iterator[Item]:
    """Topics and messages of one file in its own order, read without its index.

    Raises:
        BrokenOffError: where it cannot be read further; what came before is good.
    """
    try:
        with path.open("rb") as stream:
            magic = stream.read(len(SQLITE_MAGIC))
            size = path.stat().st_size
            if magic.startswith(MCAP_MAGIC):
                stream.seek(len(MCAP_MAGIC))
                yield from map(opened, scan_mcap(stream, size))
            elif magic.startswith(ROS1_MAGIC):
                stream.seek(len(ROS1_MAGIC))
                yield from scan_ros1(stream, size)
            elif magic == SQLITE_MAGIC:
                yield from map(opened, scan_sqlite(path))
            else:
                raise BrokenOffError("it begins like no MCAP file, ROS 1 bag or sqlite3 file (is it a bag at all?)")
    except OSError as wrong:
        raise BrokenOffError(wrong.strerror or str(wrong)) from None


def opened(item: Item) -> Item:
    """The item with its message unpacked, where a recorder packs each for itself."""
    if isinstance(item, Channel) or not item[2].startswith(ZSTD_MAGIC):
        return item
    return item[0], item[1], unpack_zstd(item[2])


def scan_mcap(stream: BinaryIO, size: int) -> Iterator[Item]:
    """The records up to the end of data; chunks are unpacked."""
    declared = McapTables({}, {})
    for place, code, body in mcap_records(stream, size):
        if code == DATA_END:
            return
        try:
            if code != CHUNK:
                yield from mcap_item(code, body, declared)
                continue
            for _, inner, content in mcap_records(BytesIO(unpacked(body)), None):
                yield from mcap_item(inner, content, declared)
        except (struct.error, ValueError, UnicodeDecodeError) as wrong:
            raise BrokenOffError(f"the record at byte {place} is damaged ({wrong})") from None
        except BrokenOffError as wrong:
            raise BrokenOffError(f"the chunk at byte {place} is damaged: {wrong}") from None
    raise BrokenOffError(f"it ends at byte {size} without its end mark")


@dataclass(frozen=True)
class McapTables:
    """The schemas and channels that an MCAP file has declared so far."""

    schemas: dict[int, tuple[str, str, str]]  # name, encoding, definition
    channels: dict[int, Channel]


def mcap_item(code: int, body: bytes, declared: McapTables) -> Iterator[Item]:
    """The topic or message of one record, if it holds one; declarations are added to `declared`."""
    if code == SCHEMA:
        reader = Fields(body)
        key = reader.number("<H")
        declared.schemas[key] = (reader.text(), reader.text(), reader.text())
    elif code == CHANNEL:
        reader = Fields(body)
        key, schema = reader.number("<H"), reader.number("<H")
        name, kind, text = declared.schemas.get(schema, ("", "", ""))
        channel = Channel(reader.text(), message_type(name), reader.text(), text, idl=kind.endswith("idl"))
        declared.channels[key] = channel
        yield channel
    elif code == MESSAGE:
        key, _, received, _ = struct.unpack_from("<HIQQ", body)
        if key in declared.channels:
            yield declared.channels[key], received, body[22:]


def mcap_records(stream: BinaryIO, size: int | None) -> Iterator[tuple[int, int, bytes]]:
    """Place, code and content of every record; `size` is the file's, None within a chunk."""
    while head := stream.read(9):
        place = stream.tell() - len(head)
        length = struct.unpack("<Q", head[1:])[0] if len(head) == 9 else 0
        fits = size is None or length <= size - stream.tell()
        body = stream.read(length) if fits else b""
        if len(head) < 9 or len(body) < length:
            raise BrokenOffError(f"the record at byte {place} is cut off")
        yield place, head[0], body


def unpacked(chunk: bytes) -> bytes:
    """The records inside a chunk; its checksum must hold."""
    reader = Fields(chunk[16:])
    size, checksum = reader.number("<Q"), reader.number("<I")
    compression = reader.text()
    return unpack_mcap_chunk(reader.take(reader.number("<Q")), compression, size, checksum)


def message_type(name: str) -> str:
    """The name as rosbags keeps types: PACKAGE/msg/NAME, whether a bag writes the middle or not."""
    package, _, last = name.rpartition("/")
    return name if package.rpartition("/")[2] == "msg" else f"{package}/msg/{last}"


class Fields:
    """Numbers and texts of a record, one after the other."""

    def __init__(self, body: bytes) -> None:
        self.body, self.position = body, 0

    def take(self, count: int) -> bytes:
        if self.position + count > len(self.body):
            raise ValueError("a field is longer than its record")
        self.position += count
        return self.body[self.position - count : self.position]

    def number(self, layout: str) -> int:
        return int(struct.unpack(layout, self.take(struct.calcsize(layout)))[0])

    def text(self) -> str:
        return self.take(self.number("<I")).decode()


def scan_ros1(stream: BinaryIO, size: int) -> Iterator[Item]:
    """The records up to the index; chunks are unpacked."""
    channels: dict[int, Channel] = {}
    index = 0
    for place, header, body in ros1_records(stream, size):
        code = header.get("op", b"\0")[0]
        try:
            if code == ROS1_HEADER:
                index = struct.unpack("<Q", header["index_pos"])[0]
            elif code == ROS1_CHUNK_INFO:
                return
            elif code == ROS1_CHUNK:
                kind = header["compression"].decode()
                for _, inner, content in ros1_records(BytesIO(unpack_ros1_chunk(body, kind)), None):
                    yield from ros1_item(inner, content, channels)
            else:
                yield from ros1_item(header, body, channels)
        except (struct.error, KeyError, ValueError, UnicodeDecodeError) as wrong:
            raise BrokenOffError(f"the record at byte {place} is damaged ({wrong})") from None
        except BrokenOffError as wrong:
            raise BrokenOffError(f"the chunk at byte {place} is damaged: {wrong}") from None
    if index > size:
        raise BrokenOffError(f"it ends at byte {size}, before its index at byte {index}")


def ros1_item(header: dict[str, bytes], body: bytes, channels: dict[int, Channel]) -> Iterator[Item]:
    """The topic or message of one record of a ROS 1 bag, if it holds one."""
    code = header.get("op", b"\0")[0]
    if code == ROS1_CONNECTION:
        key = struct.unpack("<I", header["conn"])[0]
        connection = ros1_fields(body)
        kind, text = message_type(connection["type"].decode()), connection["message_definition"].decode()
        channels[key] = Channel(header["topic"].decode(), kind, "ros1", text, idl=False)
        yield channels[key]
    elif code == ROS1_MESSAGE:
        seconds, rest = struct.unpack("<II", header["time"])
        channel = channels.get(struct.unpack("<I", header["conn"])[0])
        if channel is not None:
            yield channel, seconds * 10**9 + rest, body


def ros1_records(stream: BinaryIO, size: int | None) -> Iterator[tuple[int, dict[str, bytes], bytes]]:
    """Place, header fields and content of every record; `size` is the file's, None within a chunk."""
    while first := stream.read(4):
        place = stream.tell() - len(first)
        parts = []
        for part in range(2):
            count = first if part == 0 else stream.read(4)
            length = struct.unpack("<I", count)[0] if len(count) == 4 else 0
            fits = size is None or length <= size - stream.tell()
            parts.append(stream.read(length) if fits else b"")
            if len(count) < 4 or len(parts[-1]) < length:
                raise BrokenOffError(f"the record at byte {place} is cut off")
        try:
            yield place, ros1_fields(parts[0]), parts[1]
        except (struct.error, ValueError) as wrong:
            raise BrokenOffError(f"the record at byte {place} is damaged ({wrong})") from None


def ros1_fields(body: bytes) -> dict[str, bytes]:
    """`name=value` fields of a ROS 1 header."""
    fields, start = {}, 0
    while start < len(body):
        end = start + 4 + struct.unpack_from("<I", body, start)[0]
        if end > len(body):
            raise ValueError("a field is longer than its header")
        name, _, value = body[start + 4 : end].partition(b"=")
        fields[name.decode()] = value
        start = end
    return fields
