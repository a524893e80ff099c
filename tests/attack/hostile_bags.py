"""Bags that no robot writes: types without end, chunks that say what they are not, databases that are programs."""

from __future__ import annotations

import bz2
import os
import sqlite3
import struct
from collections.abc import Callable
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer as McapWriter

from tests.attack.family import Case, Harm
from tests.recording.bagged import RULE, STAMPED, Log, log, write_mcap

BAG = {"mcap": "log.mcap", "ros1": "log.bag", "sqlite": "log.db3"}
WRENCH = "geometry_msgs/msg/WrenchStamped"
HEAD = b"\0\1\0\0"  # of a message in CDR
LETTERS = "ABCDEFG"
CODE = "__import__('os').system('touch pwned')"


def declared(
    definition: str | bytes,
    *,
    data: bytes = HEAD + b"\0" * 64,
    name: str = WRENCH,
    encoding: str = "ros2msg",
    packing: str = "cdr",
    messages: int = 12,
) -> Harm:
    """An MCAP file with a topic /wrench of messages that are defined so."""

    def harm(folder: Path) -> None:
        with (folder / BAG["mcap"]).open("wb") as stream:
            writer = McapWriter(stream, compression=CompressionType.ZSTD)
            writer.start(profile="ros2", library="a test")
            text = definition if isinstance(definition, bytes) else definition.encode()
            schema = writer.register_schema(name=name, encoding=encoding, data=text)
            channel = writer.register_channel(topic="/wrench", message_encoding=packing, schema_id=schema)
            for i in range(messages):
                writer.add_message(channel, log_time=i * 10**7, publish_time=0, data=data)
            writer.finish()  # type: ignore[no-untyped-call]

    return harm


def chunk(size: int, pack: Callable[[], bytes], kind: bytes) -> Harm:
    """An MCAP file of one chunk that says that it has `size` bytes."""

    def record(code: int, body: bytes) -> bytes:
        return bytes([code]) + struct.pack("<Q", len(body)) + body

    def text(word: bytes) -> bytes:
        return struct.pack("<I", len(word)) + word

    def harm(folder: Path) -> None:
        packed = pack()
        body = struct.pack("<QQQI", 0, 1, size, 0) + text(kind) + struct.pack("<Q", len(packed)) + packed
        parts = [record(1, text(b"ros2") + text(b"x")), record(6, body), record(15, struct.pack("<I", 0))]
        magic = b"\x89MCAP0\r\n"
        whole = magic + b"".join(parts) + record(2, struct.pack("<QQI", 0, 0, 0)) + magic
        (folder / BAG["mcap"]).write_bytes(whole)

    return harm


def zeros(gigabytes: float) -> bytes:
    """So many zeros, packed."""
    packer = bz2.BZ2Compressor()
    block = b"\0" * 2**24
    return b"".join(packer.compress(block) for _ in range(int(gigabytes * 64))) + packer.flush()


def ros1(gigabytes: float) -> Harm:
    """A ROS 1 bag, not indexed, that says it has 4e9 topics, with a chunk of so many zeros."""

    def framed(header: dict[bytes, bytes], body: bytes) -> bytes:
        fields = b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k + b"=" + v for k, v in header.items())
        return struct.pack("<I", len(fields)) + fields + struct.pack("<I", len(body)) + body

    def harm(folder: Path) -> None:
        top = {b"op": b"\3", b"index_pos": bytes(8), b"conn_count": b"\xff" * 4, b"chunk_count": b"\xff" * 4}
        chunk = {b"op": b"\5", b"compression": b"bz2", b"size": b"\xff" * 4}
        content = framed(chunk, zeros(gigabytes)) if gigabytes else b""
        (folder / BAG["ros1"]).write_bytes(b"#ROSBAG V2.0\n" + framed(top, b"") + content)

    return harm


def database(script: str, topics: str = "TABLE") -> Harm:
    """A sqlite3 bag with a topic /wrench, and what the script adds."""

    def harm(folder: Path) -> None:
        with closing(sqlite3.connect(folder / BAG["sqlite"])) as base:
            if topics == "TABLE":
                base.execute(TOPICS)
                base.execute(f"INSERT INTO topics VALUES(1, '/wrench', '{WRENCH}', 'cdr', '')")
            base.executescript(script)
            base.commit()

    return harm


def spoilt(folder: Path) -> None:
    write_mcap(folder / BAG["mcap"], log())
    content = bytearray((folder / BAG["mcap"]).read_bytes())
    content[200:] = np.random.default_rng(0).bytes(len(content) - 200)
    (folder / BAG["mcap"]).write_bytes(content)


def long_stamp(folder: Path) -> None:
    one = log()
    write_mcap(folder / BAG["mcap"], Log(np.append(one.stamp[:-1], 2**60), one.force))


def sparse_bag(folder: Path) -> None:
    write_mcap(folder / BAG["mcap"], log())
    os.truncate(folder / BAG["mcap"], 2**33)


def strong(folder: Path) -> None:
    write_mcap(folder / BAG["mcap"], Log(log().stamp, 1e300 * log().force))


def parts(*messages: tuple[str, str]) -> str:
    """Definitions of further messages, after the first."""
    return "".join(f"\n{RULE}\nMSG: geometry_msgs/{name}\n{text}" for name, text in messages)


EMPTY_ROW = "uint8 X=1"
DOUBLED = [(f"A{i}", f"A{i + 1} a\nA{i + 1} b") for i in range(1, 28)]
IDL = "module a {{ module msg {{ {} struct X {{ {} }}; }}; }};"
TOPICS = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format, offered_qos_profiles)"
ENDLESS = "SELECT id, 1 AS topic_id, id AS timestamp, zeroblob(9) AS data FROM c;"
COUNTING = "WITH RECURSIVE c(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM c)"
PLAIN = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data);"
ROWS = "".join(f"INSERT INTO messages(topic_id, timestamp) VALUES(1, {i});" for i in range(50))
HUGE = "data BLOB /**/ AS /**/ (zeroblob(900000000))"
COMPUTED = f"CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, {HUGE});"
TYPES = [
    Case("a type that holds itself", declared("WrenchStamped inner\nfloat64 x"), "is not known"),
    Case("types that hold each other", declared("A a" + parts(("A", "B b"), ("B", "A a"))), "is not known"),
    Case("a list of itself", declared("WrenchStamped[] inner"), "is not known"),
    Case("an array without end", declared("float64[100000000000] x"), "an array of 100000000000 entries"),
    Case("an array of texts", declared("string[1000000000] x"), "an array of 1000000000 entries"),
    Case("a size of 5000 digits", declared(f"float64[{'9' * 5000}] x"), "is none"),
    Case(
        "arrays of arrays",
        declared("A[1000] a" + parts(*((a, f"{b}[1000] b") for a, b in pairwise(LETTERS)), ("G", "int8 x"))),
        "an array of 1000 entries",
    ),
    Case("doubling types", declared("A1 a\nA1 b" + parts(*DOUBLED, ("A28", "uint8 x"))), "is no "),
    Case("doubling types of nothing", declared("A1 a\nA1 b" + parts(*DOUBLED, ("A28", EMPTY_ROW))), "is no "),
    Case(
        "a list of nothing",
        declared("E[] a" + parts(("E", EMPTY_ROW)), data=HEAD + b"\xff" * 4),
        "Invalid sequence length",
    ),
    Case("a list of 4e9 numbers", declared("float64[] a", data=HEAD + b"\xff" * 4), "Invalid sequence length"),
    Case("a list of 4e9 texts", declared("string[] a", data=HEAD + b"\xff" * 4), "Invalid sequence length"),
    Case("3000 levels", declared("A0 a" + parts(*((f"A{i}", f"A{i + 1} a") for i in range(900)))), "is not known"),
    Case("a definition of 5 MB", declared("float64 x\n" * 500_000), "is none"),
    Case("a line of 1 MB", declared("float64 " + "x" * 1_000_000), "is none"),
    Case("a type's name that is code", declared("float64 x", name=f"a/msg/X\n{CODE}\n#"), r"a/msg/X\\n"),
    Case("a type's name that ends a text", declared("float64 x", name=f"a/msg/X'+str({CODE})+'"), "is not known"),
    Case("a field that is code", declared(f"float64 x={CODE}"), "is not known"),
    Case("a constant that is code", declared(f"string X='+{CODE}+'\nfloat64 y"), "is no |not known"),
    Case("a default that is code", declared(f'string y "\\"+{CODE}"'), "is no |not known"),
    Case("a field named class", declared("float64 class\nfloat64 import"), "'class' is no name of a field"),
    Case("a field with underscores", declared("float64 __class__"), "is not known"),
    Case("IDL: nested modules", declared("module a {" * 5000, name="a/msg/X", encoding="ros2idl"), "is none"),
    Case(
        "IDL: an array",
        declared(IDL.format("", "double z[9999999999];"), name="a/msg/X", encoding="ros2idl"),
        "an array of 9999999999",
    ),
    Case(
        "IDL: a power",
        declared(IDL.format("const long N = 1<<999999999999;", "double z[N];"), name="a/msg/X", encoding="ros2idl"),
        "is not known",
    ),
    Case("a definition of bytes", declared(bytes(range(256)) * 9), "damaged"),
    Case("an unknown packing", declared("float64 x", packing="json"), "cdr and ros1 can be read"),
]
CHUNKS = [
    Case("a chunk of 2^63 bytes", chunk(2**63 - 1, lambda: b"abc", b""), "size mismatch"),
    Case("a chunk packed otherwise", chunk(9, lambda: b"abc", b"zip"), "compression 'zip'"),
    Case("many messages of 128 MB", declared(STAMPED, data=b"\0" * 2**27, messages=12), "is no "),
    Case("ROS 1: 2 GB in a chunk", ros1(2.0), "not indexed"),
    Case("ROS 1: 4e9 topics", ros1(0.0), "not indexed|no message|No message"),
    Case("noise", spoilt, "damaged"),
    Case("a sparse bag", sparse_bag, "end magic"),
    Case("a stamp in the year 2006", long_stamp, "Correct the wrong times"),
    Case(
        "forces of 1e300",
        lambda folder: write_mcap(folder / "log.mcap", Log(log().stamp, 1e300 * log().force)),
        "force",
    ),
]
DATABASES = [
    Case("a view without end", database(f"CREATE VIEW messages AS {COUNTING} {ENDLESS}"), "'messages' is no table"),
    Case("topics without end", database(f"CREATE VIEW topics AS {COUNTING} {ENDLESS}", "VIEW"), "'topics' is no table"),
    Case("columns that are computed", database(COMPUTED + ROWS), "'messages' is no table"),
    Case("messages that are none", database(f"{PLAIN}INSERT INTO messages VALUES(1, 1, 'abc', 'text');"), "."),
]
CASES = [*TYPES, *CHUNKS, *DATABASES]
