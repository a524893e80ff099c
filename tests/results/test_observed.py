"""Observations come back whole from their file, whatever fields the records have."""

from __future__ import annotations

import json
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from onebend.errors import ResultsError
from onebend.record_data import fields_from, record_from, to_data
from onebend.records import (
    ForceNoise,
    FrameMeans,
    KnownLoads,
    MassLine,
    MeasuredFrequency,
    Observations,
    PointMass,
    Readings,
    Remark,
    Stated,
    StatedSection,
    ToolTrack,
)
from onebend.results.observations_file import load_observations, observations_beside, save_observations
from tests import made_up
from tests.made_up import same, with_source


def full() -> Observations:
    """Observations with no field at its default."""
    made = made_up.observations()
    clean, frames = made.source.clean_force, len(made.time)
    assert clean is not None
    rng = np.random.default_rng(0)
    source = replace(
        made.source,
        video=Path("film") / "video.mp4",
        place_seen=True,
        video_topic="/camera",
        view=replace(made_up.overhead_view(), lying=rng.normal(size=(3, 11))),
        clean_force=replace(
            clean,
            push_s=np.linspace(0.5, 1.0, len(clean.time)),
            noise=ForceNoise(0.03, 0.01, 0.2, 0.004, spacing=0.001, level=0.02, load=0.05),
            zero_time=np.array([1.0]),
            zero=np.array([[0.1, 1 / 3]]),
            remarks=(Remark("note", "the log drifts"),),
        ),
        remarks=(*made.source.remarks, Remark("warning", "the force contradicts", doubt=True)),
    )
    stated = Stated(
        rest="unknown",
        mass=0.1,
        placement_sd=1e-3,
        mass_sd=0.2,
        weighed_sd=0.01,
        mass_line=MassLine(np.array([0.0, 1.0]), np.array([0.3, 1 / 7])),
        mass_along="table",
        stiffness_along="even",
        modulus_varies=0.1,
        turn_sd=0.1,
        place_sd=2e-3,
        direction_sd=0.2,
        gravity_sd=0.3,
        clamp_sd=0.3,
        curvature_sd=0.4,
        scale_sd=0.5,
        gain_sd=0.02,
        thickness=0.025,
        tag_size=0.012,
        load_error_sd=0.6,
        section=StatedSection(
            "tube",
            np.array([0.1, 1.0]),
            np.full(2, 1 / 3),
            np.full(2, 1 / 3),
            1e-4,
            inner=np.full(2, 1 / 7),
            moment=np.full(2, 1e-9),
            moment_sd=0.05,
        ),
        friction_sd=0.3,
        rest_change_sd=1 / 30,
        masses=(PointMass(0.3, 1 / 300), PointMass(1.0, 0.001)),
    )
    known = KnownLoads(
        rng.normal(size=(frames, 2, 2)), np.ones((frames, 2)), np.zeros((frames, 0)), np.ones((frames, 0))
    )
    return replace(
        made,
        source=source,
        stated=stated,
        force_sd=np.array([np.inf, 1 / 3]),
        held=np.arange(frames) > 3,
        known_loads=known,
        frequencies=(MeasuredFrequency(1 / 3, 0.01, 2, (0.1, -9.81), 0.02),),
        means=FrameMeans(np.arange(frames) + 1, rng.normal(size=made.xy.shape)),
        by_camera=rng.normal(size=(frames, len(made.marker_s), 3, 7)),
        sd_known=False,
        traced=np.arange(len(made.marker_s)) > 1,
        width=rng.random((5, 2)),
        tool=ToolTrack(np.arange(4.0), rng.random(4), rng.random(4), rng.random((4, 2))),
        readings=Readings("x", 2, 1 / 7),
        static=True,
        pose_names=tuple(f"pose {i}" for i in range(frames)),
    )


def assert_same(a: Any, b: Any, where: str) -> None:
    if is_dataclass(a) and type(a) is type(b):
        for item in fields(a):
            assert_same(getattr(a, item.name), getattr(b, item.name), f"{where}.{item.name}")
    else:
        assert type(a) is type(b), where
        assert same(a, b), where


def defaults_left(record: Any) -> list[str]:
    """The fields, of records inside too, that have the value they have when nobody gives one."""
    out = []
    for item in fields(record):
        value = getattr(record, item.name)
        default = item.default if item.default_factory is MISSING else item.default_factory()
        if default is not MISSING and type(default) is type(value) and same(default, value):
            out.append(f"{type(record).__name__}.{item.name}")
        if is_dataclass(value):
            out += defaults_left(value)
    return out


def test_every_field_of_observations_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    before = full()
    assert defaults_left(before) == [], "give the new field a value in `full`, so that its saving is tested"
    save_observations(tmp_path / "observations.parquet", before)
    assert_same(load_observations(tmp_path), before, "observations")


def test_bare_observations_come_back(tmp_path: Path) -> None:
    bare = with_source(made_up.observations(), view=None, clock=None, clean_force=None, remarks=())
    save_observations(tmp_path / "observations.parquet", bare)
    assert_same(load_observations(tmp_path), bare, "observations")


@dataclass(frozen=True)
class Holder:
    values: dict[str, float]


def test_what_a_model_was_learned_from_is_found_beside_it(tmp_path: Path) -> None:
    assert observations_beside(tmp_path / "model.json") == ()
    first, second = (
        with_source(made_up.observations(), name="first"),
        with_source(made_up.observations(), name="second"),
    )
    save_observations(tmp_path / "observations.parquet", first)
    save_observations(tmp_path / "observations-2.parquet", second)
    (tmp_path / "observations-3.parquet").write_bytes(b"damaged")
    for where in (tmp_path, tmp_path / "model.json"):
        assert {one.source.name for one in observations_beside(where)} == {"first", "second"}


def test_a_field_that_has_no_way_to_json_and_back_is_an_error() -> None:
    @dataclass(frozen=True)
    class Odd:
        value: complex

    with pytest.raises(TypeError, match="no JSON for a complex"):
        to_data(Odd(1j))
    with pytest.raises(TypeError, match="no way from JSON"):
        fields_from(Holder, {"values": {"a": 1.0}})
    with pytest.raises(ValueError, match=r"Remark has other fields: .*'level', 'why'"):
        fields_from(Remark, {"why": "note", "text": "a"})
    assert record_from(Remark, {"level": "note", "text": "a"}) == Remark("note", "a")


def test_a_filtered_force_log_comes_back_as_exact_as_its_filter_leaves_it(tmp_path: Path) -> None:
    made = made_up.observations()
    assert made.source.clean_force is not None
    time = np.arange(0.0, 12.0, 0.001)
    wave = np.stack([np.sin(2.0 * np.pi * 0.7 * time), np.cos(2.0 * np.pi * 0.5 * time)], axis=1)
    noise = ForceNoise(0.03, 0.01, 0.2, 0.004, spacing=0.001)
    clean = replace(made.source.clean_force, time=time, force=wave, push_s=None, cutoff=0.7, noise=noise)
    save_observations(tmp_path / "observations.parquet", with_source(made, clean_force=clean))
    again = load_observations(tmp_path).source.clean_force
    assert again is not None
    assert len(again.time) < 500
    assert again.noise == noise
    back = np.stack([np.interp(time, again.time, again.force[:, i]) for i in range(2)], axis=1)
    assert np.max(np.abs(back - wave)) < 2.5e-3


def test_observations_that_are_not_ours_are_named(tmp_path: Path) -> None:
    file = tmp_path / "observations.parquet"
    with pytest.raises(ResultsError, match="no such file"):
        load_observations(tmp_path)
    file.write_bytes(b"not parquet at all")
    with pytest.raises(ResultsError, match="damaged, or not written by onebend"):
        load_observations(file)
    pq.write_table(pa.table({"a": [1.0]}), file)
    with pytest.raises(ResultsError, match="damaged, or not written by onebend"):
        load_observations(file)
    save_observations(file, made_up.observations())
    table = pq.read_table(file)
    rest = json.loads(table.schema.metadata[b"onebend"])
    rest["version"] = 9
    pq.write_table(table.replace_schema_metadata({b"onebend": json.dumps(rest)}), file)
    with pytest.raises(ResultsError, match="version 9"):
        load_observations(file)
