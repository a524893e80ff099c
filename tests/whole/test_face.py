"""The public names: each loaded when it is asked for, and every type that a public signature names among them."""

from __future__ import annotations

import importlib
import inspect
import typing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import onebend
from onebend.learning.allowances import Entry

FACES = ("", ".beam", ".control", ".lab", ".learning", ".live", ".recording", ".results")
PLAIN = (".errors", ".progress", ".records")  # modules of which everything is public
MOST_AT_THE_TOP = 29


def public(face: str) -> dict[str, Any]:
    """The public names of one face."""
    module = importlib.import_module(f"onebend{face}")
    if face in PLAIN:
        own = {
            name: value for name, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__
        }
        return {name: value for name, value in own.items() if not name.startswith("_")}
    shown = {name: getattr(module, name) for name in module.__all__}
    return {name: value for name, value in shown.items() if not isinstance(value, ModuleType)}


@pytest.fixture(scope="module")
def everything() -> dict[str, Any]:
    """All public names, for the types that a module loads only to check them."""
    names = {name: value for face in (*PLAIN, *FACES) for name, value in public(face).items()}
    return {**names, "ProcessPoolExecutor": ProcessPoolExecutor, "Entry": Entry}


def classes_in(hint: Any) -> Iterator[type]:
    """The classes of onebend that an annotation names."""
    if inspect.isclass(hint) and hint.__module__.split(".")[0] == "onebend":
        yield hint
    for part in typing.get_args(hint):
        for one in part if isinstance(part, list) else [part]:
            yield from classes_in(one)


def signatures(value: Any) -> Iterator[Any]:
    """What of a public name has annotations: a function; a class with its fields, methods and properties."""
    if not inspect.isclass(value):
        yield value
        return
    yield value
    for name, member in inspect.getmembers_static(value):
        if name.startswith("_") and name not in ("__init__", "__call__"):
            continue
        for inner in ("__func__", "fget", "func"):  # class methods, properties, cached ones
            member = getattr(member, inner, None) or member
        if inspect.isfunction(member) and member.__module__.split(".")[0] == "onebend":
            yield member


def test_every_type_of_a_public_signature_is_public(everything: dict[str, Any]) -> None:
    known = {value for value in everything.values() if inspect.isclass(value)}
    missing = set()
    for name, value in everything.items():
        if not callable(value) or not getattr(value, "__module__", "").startswith("onebend"):
            continue
        for signature in signatures(value):
            hints = typing.get_type_hints(signature, localns=everything)
            for field, hint in hints.items():
                if not field.startswith("_"):
                    missing |= {
                        f"{one.__module__}.{one.__name__} (of {name})" for one in classes_in(hint) if one not in known
                    }
    assert sorted(missing) == []


@pytest.mark.parametrize("face", FACES)
def test_no_public_name_is_a_module_of_its_package(face: str) -> None:
    """`onebend.rehearse` was a function until somebody imported the package of that name."""
    module = importlib.import_module(f"onebend{face}")
    if module.__file__ is None or not module.__file__.endswith("__init__.py"):
        return
    inside = {path.stem for path in Path(module.__file__).parent.iterdir()}
    assert not inside & set(public(face))


@pytest.mark.parametrize("face", FACES)
def test_every_name_of_the_stub_can_be_loaded(face: str) -> None:
    module = importlib.import_module(f"onebend{face}")
    assert all(getattr(module, name) is not None for name in module.__all__)
    assert set(module.__all__) <= set(dir(module))


def test_the_top_is_small_and_its_plain_verbs_are_the_fit() -> None:
    top = public("")
    assert len(top) <= MOST_AT_THE_TOP
    assert typing.get_type_hints(onebend.fit)["return"] is onebend.Posterior
    assert typing.get_type_hints(onebend.learn)["return"] is onebend.Run
    with pytest.raises(AttributeError, match="attribute Push"):
        onebend.Push  # type: ignore[attr-defined] # noqa: B018


def test_a_shape_takes_the_pushers_of_control() -> None:
    beam = onebend.Beam(0.15, onebend.Uniform(0.02))
    targets = onebend.control.points(1.0, beam.equilibrium((0.0, 0.1)).xy(1.0))
    found = onebend.shape(beam, targets, pushes=[onebend.control.Pusher(1.0)])
    assert found.rms < 1e-6
    assert np.allclose(found.forces, [[0.0, 0.1]], atol=1e-3)
