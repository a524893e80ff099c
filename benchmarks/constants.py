"""Which constants of the fit k(s) rests on: each is doubled and halved, and what changes is told in sds of the band.

All take an hour or two; `python -m benchmarks.constants learning.allowances beam` changes only those of these modules.

Every number that a module of the learning or of the mechanics names at its top is changed by itself, in a process of
its own, before the module is compiled, if the fit loads the module. The fit then runs on recordings that were observed
once. `shift`: the largest RMS over s of the change of log k over the sd that the unchanged fit claims, of both changes
and all recordings. `width`: the largest change of the band's mean width. A shift of one sd or more is what the band
does not hold: such a constant is knowledge of the world and names its source. Constants without effect are limits that
these recordings do not reach, or choices that do not matter.
"""

from __future__ import annotations

import argparse
import ast
import importlib.abc
import importlib.machinery
import json
import math
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import CodeType
from typing import Any

import numpy as np

from benchmarks.truth import parser_of

SOURCE = Path(__file__).parents[1] / "src"
ROOMS = ("onebend/learning", "onebend/beam")
SEEN = ("wild/mix_quadratic_s08", "tracks/mix_006")
S = np.linspace(0.05, 0.9, 60)
FACTORS = (2.0, 0.5)
LEAST = 0.1  # shifts in sd, or shares of the width, that are shown


@dataclass(frozen=True)
class Number:
    """A number, or an array of numbers, that a module names at its top."""

    module: str
    name: str
    value: str  # as it is written


def _names(statement: ast.stmt) -> Iterator[tuple[str, ast.expr]]:
    """Names and values of an assignment to constants; `A, B = 1, 2` is two."""
    target: ast.expr
    if isinstance(statement, ast.AnnAssign) and statement.value is not None:
        target, value = statement.target, statement.value
    elif isinstance(statement, ast.Assign) and len(statement.targets) == 1:
        target, value = statement.targets[0], statement.value
    else:
        return
    pairs = [(target, value)]
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        pairs = list(zip(target.elts, value.elts, strict=True))
    for one, what in pairs:
        if isinstance(one, ast.Name) and one.id.lstrip("_").isupper():
            yield one.id, what


def _is_number(value: ast.expr) -> bool:
    """Whether it is a number, or `np.array([...])` of numbers."""
    if isinstance(value, ast.Call):
        return ast.unparse(value.func) == "np.array" and len(value.args) == 1 and _is_number(value.args[0])
    if isinstance(value, ast.List):
        return bool(value.elts) and all(_is_number(one) for one in value.elts)
    return isinstance(value, ast.Constant) and type(value.value) in (int, float)


def numbers() -> list[Number]:
    """All that are changed, in the order of their files."""
    found = []
    for path in sorted(one for room in ROOMS for one in (SOURCE / room).rglob("*.py")):
        module = ".".join(path.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__")
        for statement in ast.parse(path.read_text(encoding="utf-8")).body:
            found += [Number(module, name, ast.unparse(v)) for name, v in _names(statement) if _is_number(v)]
    return found


class _Changed(importlib.machinery.SourceFileLoader):
    """Compiles a module with one of its numbers changed."""

    def __init__(self, fullname: str, path: str, name: str, factor: float) -> None:
        super().__init__(fullname, path)
        self.name_of_number, self.factor = name, factor

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        tree = ast.parse(self.get_data(path))
        for statement in tree.body:
            for name, value in _names(statement):
                if name == self.name_of_number:
                    for one in ast.walk(value):
                        if isinstance(one, ast.Constant) and type(one.value) in (int, float):
                            one.value = self._of(one.value)
        return compile(tree, path, "exec")

    def _of(self, value: Any) -> Any:
        if isinstance(value, float):
            return value * self.factor
        return math.ceil(value * self.factor) if value > 0 else value


class _Finder(importlib.abc.MetaPathFinder):
    def __init__(self, number: Number, factor: float) -> None:
        self.number, self.factor = number, factor

    def find_spec(self, fullname: str, path: Any, _target: Any = None) -> importlib.machinery.ModuleSpec | None:
        if fullname != self.number.module:
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path)
        assert spec is not None
        assert spec.origin is not None
        spec.loader = _Changed(fullname, spec.origin, self.number.name, self.factor)
        return spec


def fitted(kept: Path) -> dict[str, Any]:
    """What the fits of kept observations say, and which modules they loaded; in the process that was changed, which
    loads them only here."""
    from onebend.beam.stiffness import half_width
    from onebend.errors import OnebendError
    from onebend.learning.posterior import fit
    from onebend.records import GAIN_SD

    said = []
    for seen in pickle.loads(kept.read_bytes()):
        try:
            band = fit([seen], gain_sd=max(seen.stated.gain_sd, GAIN_SD)).band(S)
        except (OnebendError, ArithmeticError, ValueError, np.linalg.LinAlgError) as wrong:
            return {"failure": f"{type(wrong).__name__}: {wrong}".splitlines()[0][:80]}
        sd = np.log(band.high / band.low) / (2.0 * half_width(1.0))
        said.append([np.log(band.k).tolist(), sd.tolist()])
    return {"said": said, "modules": [name for name in sys.modules if name.startswith("onebend.")]}


def asked(kept: Path, number: Number | None = None, factor: float = 1.0) -> dict[str, Any]:
    """`fitted` in a new process, with a number changed."""
    changed = [] if number is None else [number.module, number.name, repr(factor)]
    command = [sys.executable, "-m", "benchmarks.constants", "--fitted", str(kept), *changed]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=SOURCE.parent, env=environment, capture_output=True, text=True, check=False)
    lines = (done.stdout if done.returncode == 0 else done.stderr).splitlines()
    if done.returncode:
        return {"failure": lines[-1][:80] if lines else f"exit code {done.returncode}"}
    return dict(json.loads(lines[-1]))


def row(kept: Path, number: Number, usual: Sequence[Any]) -> tuple[float, float, str]:
    """Largest shift in sds, largest change of width, and what failed."""
    shift = width = 0.0
    failures = []
    for factor in FACTORS:
        found = asked(kept, number, factor)
        if "failure" in found:
            failures.append(f"times {factor:g}: {found['failure']}")
            continue
        for (log_k, sd), (usual_log_k, usual_sd) in zip(np.array(found["said"]), np.array(usual), strict=True):
            shift = max(shift, float(np.sqrt(np.mean(((log_k - usual_log_k) / usual_sd) ** 2))))
            width = max(width, abs(float(np.mean(sd) / np.mean(usual_sd)) - 1.0))
    return shift, width, "; ".join(failures)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("modules", nargs="*", metavar="MODULE", help="of onebend; default: all that the fit loads")
    parser.add_argument("--fitted", type=Path, help=argparse.SUPPRESS)  # in the process of one number
    given = parser.parse_args()
    if given.fitted is not None:
        if given.modules:
            module, name, factor = given.modules
            sys.meta_path.insert(0, _Finder(Number(module, name, ""), float(factor)))
        print(json.dumps(fitted(given.fitted)))
        return
    from onebend.recording.observe import observe

    with tempfile.TemporaryDirectory() as place:
        kept = Path(place) / "seen.pickle"
        kept.write_bytes(pickle.dumps([observe(given.recordings / name) for name in SEEN]))
        usual = asked(kept)
        if "failure" in usual:
            sys.exit(f"the unchanged fit failed: {usual['failure']}")
        parts = tuple(f"onebend.{name}" for name in given.modules) or ("onebend.",)
        every = [one for one in numbers() if one.module in usual["modules"] and one.module.startswith(parts)]
        with ThreadPoolExecutor(2) as pool:
            rows = list(pool.map(lambda one: row(kept, one, usual["said"]), every))
    shown = sorted(zip(every, rows, strict=True), key=lambda pair: -max(pair[1][0], pair[1][1]))
    print(f"{len(every)} numbers, fits of {' and '.join(SEEN)}.\n")
    print("| number | value | shift [sd] | width [%] | what failed |\n| --- | --- | --- | --- | --- |")
    for one, (shift, width, failed) in shown:
        if failed or max(shift, width) >= LEAST:
            where = one.module.removeprefix("onebend.")
            print(f"| {where}.{one.name} | {one.value} | {shift:.2f} | {100.0 * width:.0f} | {failed} |")
    small = sum(not failed and max(shift, width) < LEAST for _, (shift, width, failed) in shown)
    none = [one for one, (shift, width, failed) in shown if not failed and shift == 0.0 and width == 0.0]
    print(f"\nOthers, with less of both: {small}. Without any effect: {', '.join(one.name for one in none) or 'none'}.")


if __name__ == "__main__":
    main()
