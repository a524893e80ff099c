"""Frozen records as JSON, field by field: what a record holds follows from its class, not from a list kept by hand.

An array stands as its shape, its type and its values in one row, so that an empty one comes back as it was. Python's
JSON keeps NaN and infinity, and floats to the last bit.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np


def to_data(record: Any, leave_out: Collection[str] = ()) -> dict[str, Any]:
    """All fields of a record but those left out."""
    return {item.name: _data(getattr(record, item.name)) for item in fields(record) if item.name not in leave_out}


def fields_from(kind: type, data: dict[str, Any], leave_out: Collection[str] = ()) -> dict[str, Any]:
    """The fields of a `kind` of record, as its class names and types them, but for those left out.

    Raises:
        ValueError: a field is missing, or there is one that the class does not have.
    """
    types = {name: type_ for name, type_ in _types(kind).items() if name not in leave_out}
    if set(types) != set(data):
        raise ValueError(f"{kind.__name__} has other fields: {sorted(set(types) ^ set(data))}")
    return {name: _value(type_, data[name]) for name, type_ in types.items()}


@cache
def _types(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {item.name: hints[item.name] for item in fields(kind)}


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
    if origin in (Union, UnionType):  # a value or None
        (one,) = (item for item in inside if item is not type(None))
        return None if data is None else _value(one, data)
    if origin is np.ndarray:
        return np.array(data["values"], dtype=data["type"]).reshape(data["shape"])
    if origin is tuple:  # of any length, all of one type
        return tuple(_value(inside[0], item) for item in data)
    if origin is Literal:
        if data not in inside:
            raise ValueError(f"{data!r} is none of {inside}")
        return data
    if is_dataclass(type_) and isinstance(type_, type):
        return type_(**fields_from(type_, data))
    if type_ in (bool, int, float, str, Path):
        return type_(data)
    raise TypeError(f"no way from JSON to {type_}")
