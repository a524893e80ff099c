"""Of rosbags only its documented interface is used, but for one table, whose lack is told in words."""

from __future__ import annotations

import ast
import bz2
import tomllib
from pathlib import Path
from zlib import crc32

import pytest
from rosbags.rosbag2 import storage_mcap

from onebend.errors import RecordingError
from onebend.recording.damaged_bags import VERSIONS, BrokenOffError, message_type, unpack_mcap_chunk, unpack_ros1_chunk

ROOT = Path(__file__).parents[3]
DOCUMENTED = {"interfaces", "interfaces.typing", "rosbag1", "rosbag2", "serde", "typesys", "typesys.store"}


def test_only_documented_modules_of_rosbags_are_imported() -> None:
    modules = set()
    for path in (ROOT / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            modules |= {name.removeprefix("rosbags.") for name in names if name.startswith("rosbags.")}
    assert modules <= DOCUMENTED


def test_the_versions_of_the_message_are_those_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert VERSIONS in project["optional-dependencies"]["ros"]


def test_a_rosbags_without_the_table_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(storage_mcap, "DECOMPRESSORS")
    with pytest.raises(RecordingError, match=r"lacks rosbags.rosbag2.storage_mcap.DECOMPRESSORS.*pip install 'rosbags"):
        unpack_mcap_chunk(b"abc", "", 3, 0)


def test_chunks_are_checked() -> None:
    assert unpack_mcap_chunk(b"abc", "", 3, crc32(b"abc")) == b"abc"
    assert unpack_ros1_chunk(b"abc", "none") == b"abc"
    assert unpack_ros1_chunk(bz2.compress(b"abc"), "bz2") == b"abc"
    for packed, compression, size, checksum, why in (
        (b"abc", "", 4, 0, "holds 3 bytes and says that it has 4"),
        (b"abc", "", 3, 1, "checksum does not hold"),
        (b"abc", "zstd", 3, 0, "cannot be unpacked"),
        (b"abc", "zip", 3, 0, "packed as 'zip', which is not known"),
    ):
        with pytest.raises(BrokenOffError, match=why):
            unpack_mcap_chunk(packed, compression, size, checksum)


@pytest.mark.parametrize("name", ["std_msgs/String", "std_msgs/msg/String"])
def test_types_have_one_name_in_both_generations(name: str) -> None:
    assert message_type(name) == "std_msgs/msg/String"
