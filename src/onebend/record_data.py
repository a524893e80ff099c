"""Frozen records as plain data, for JSON, and back, by their fields."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

Record = TypeVar("Record")


def to_data(record: Any, leave_out: Collection[str] = ()) -> dict[str, Any]:
    """The fields; arrays as shape, type and values."""
    return {item.name: _data(getattr(record, item.name)) for item in fields(record) if item.name not in leave_out}


def record_from(kind: type[Record], data: Mapping[str, Any]) -> Record:
    """The record of `kind` with these fields, typed; arrays are as in `to_data`, or lists of numbers.

    Raises `ValueError` for a missing or unknown field, or as the types do for what they cannot be made of.
    """
    return kind(**fields_from(kind, data))


def fields_from(kind: type, data: Mapping[str, Any], leave_out: Collection[str] = ()) -> dict[str, Any]:
    """Its fields, but for those with a default that are not there. Raises as `record_from`."""
    types = {name: entry for name, entry in _types(kind).items() if name not in leave_out}
    lacking = {name for name, (_, needed) in types.items() if needed and name not in data}
    if wrong := lacking | (set(data) - set(types)):
        raise ValueError(f"{kind.__name__} has other fields: {sorted(wrong)}")
    return {name: _value(types[name][0], value) for name, value in data.items()}


@cache
def _types(kind: type) -> dict[str, tuple[Any, bool]]:
    """Type of each field, and whether it has no default."""
    hints = get_type_hints(kind)
    return {one.name: (hints[one.name], one.default is one.default_factory is MISSING) for one in fields(kind)}


def _data(value: Any) -> Any:
    if is_dataclass(value):
        return to_data(value)
    if isinstance(value, np.ndarray):
        return {"shape": list(value.shape), "type": str(value.dtype), "values": value.ravel().tolist()}
    if isinstance(value, tuple):
        return [_data(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.generic):
        return value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"no JSON for a {type(value).__name__}")


def _value(type_: Any, data: Any) -> Any:
    origin, inside = get_origin(type_), get_args(type_)
    if origin in (Union, UnionType):  # optional
        (one,) = (item for item in inside if item is not type(None))
        return None if data is None else _value(one, data)
    if origin is np.ndarray:
        if isinstance(data, list):
            return np.asarray(data, dtype=float)
        return np.array(data["values"], dtype=data["type"]).reshape(data["shape"])
    if origin is tuple:  # of one type
        return tuple(_value(inside[0], item) for item in data)
    if origin is Mapping:
        return {_value(inside[0], key): _value(inside[1], item) for key, item in data.items()}
    if origin is Literal:
        if data not in inside:
            raise ValueError(f"{data!r} is none of {inside}")
        return data
    if is_dataclass(type_) and isinstance(type_, type):
        return record_from(type_, data)
    if type_ in (bool, int, float, str, Path):
        return type_(data)
    raise TypeError(f"no way from JSON to {type_}")
