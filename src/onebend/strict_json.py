"""JSON as its standard has it: no NaN and no infinity, and no character that a terminal would act on."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from math import isfinite
from typing import Any

import numpy as np

# What JSON lets stand in a string though terminals act on it or no encoding has it. (C0 it escapes by itself.)
_ACTING = re.compile("[\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\ud800-\udfff]")


def plain(value: Any) -> Any:
    """`value` as JSON knows it: arrays as lists, numbers that are not finite as None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and np.all(np.isfinite(value)):
        return value.tolist()
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not isfinite(value):
        return None
    return value


def to_json(data: Any, *, ascii_only: bool = False, readable: bool = True) -> str:
    """Strict JSON; with `ascii_only` every other character by its code. Not `readable`, it is made much faster."""
    text = json.dumps(plain(data), indent=2 if readable else None, allow_nan=False, ensure_ascii=ascii_only)
    return _ACTING.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
