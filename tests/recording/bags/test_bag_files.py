"""Files of bags are read to their end by themselves, with one limit a file; rosbags decodes types and messages."""

from __future__ import annotations

import ast
import bz2
from pathlib import Path

import pytest
from backports import zstd

from onebend.recording import bags
from onebend.recording.bags import BrokenOffError, Unpacker, message_type, scan
from tests.recording import bagged

ROOT = Path(__file__).parents[3]
DOCUMENTED = {"interfaces", "interfaces.typing", "rosbag1", "rosbag2", "serde", "typesys", "typesys.store"}
LOG = bagged.log()


def test_only_documented_modules_of_rosbags_are_imported() -> None:
    modules = set()
    for path in (ROOT / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            modules |= {name.removeprefix("rosbags.") for name in names if name.startswith("rosbags.")}
    assert modules <= DOCUMENTED


@pytest.fixture
def unpacker(tmp_path: Path) -> Unpacker:
    (tmp_path / "file").write_bytes(b"abc")
    return Unpacker(tmp_path / "file")


def test_chunks_are_unpacked_and_faults_told(unpacker: Unpacker) -> None:
    assert unpacker.unpack(b"abc", "") == unpacker.unpack(b"abc", "none") == b"abc"
    assert unpacker.unpack(bz2.compress(b"abc"), "bz2") == b"abc"
    assert unpacker.unpack(zstd.compress(b"abc") + zstd.compress(b"de"), "zstd", 5) == b"abcde"
    for packed, kind, size, why in (
        (b"abc", "zstd", 3, "cannot be unpacked"),
        (b"abc", "zip", 3, "packed as 'zip', which is not known"),
        (zstd.compress(bytes(9)), "zstd", 3, "more than the 3 bytes"),
        (bz2.compress(b"abc")[:-4], "bz2", 3, "ended before"),
    ):
        with pytest.raises(BrokenOffError, match=why):
            unpacker.unpack(packed, kind, size)


def test_the_limit_is_of_one_file(unpacker: Unpacker, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    unpacker.left = 5
    unpacker.unpack(b"abc", "")
    with pytest.raises(BrokenOffError, match="far more than a film"):
        unpacker.unpack(zstd.compress(b"abc"), "zstd")
    bag = bagged.write_mcap(tmp_path / "run.mcap", LOG)
    everything = list(scan(bag))
    assert everything == list(scan(bag))  # a second reading begins with the whole limit
    monkeypatch.setattr(bags, "MOST_READ", 0)
    monkeypatch.setattr(bags, "MOST_GAIN", 0)
    with pytest.raises(BrokenOffError, match="far more than a film"):
        list(scan(bag))


@pytest.mark.parametrize("name", ["std_msgs/String", "std_msgs/msg/String"])
def test_types_have_one_name_in_both_generations(name: str) -> None:
    assert message_type(name) == "std_msgs/msg/String"
