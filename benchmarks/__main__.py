"""`python -m benchmarks [NAME ...] [--write]`: run every benchmark (or those named), each in its own process.

A benchmark is a module of this folder with a `main()` that prints Markdown. What it prints goes to the screen and to
out/benchmarks/NAME.md, under the module's own first line and the command that makes it again. With --write, the tables
that were made replace those in docs/accuracy.md; the others stay there as they are.
"""

from __future__ import annotations

import argparse
import ast
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

FOLDER = Path(__file__).parent
OUT = FOLDER.parent / "out" / "benchmarks"
BARE = ("online", "reach", "shape", "loop", "startup")  # run as a user would: onebend sees to the BLAS threads itself
PAGE = FOLDER.parent / "docs" / "accuracy.md"
PREFACE = """\
# Accuracy and speed

Measured by the scripts in `benchmarks/` against known truth; `make bench` makes every table again, and
`python -m benchmarks --write` this page. The *development recordings* are twelve simulated and rendered ones with known
truth, made by an independent simulator and not shipped; `linear_train` and the like are their names.
"""


def benchmarks() -> dict[str, str]:
    """Name and first line of every module with a `main()`."""
    found = {}
    for path in sorted(FOLDER.glob("[a-z]*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if any(isinstance(node, ast.FunctionDef) and node.name == "main" for node in tree.body):
            found[path.stem] = (ast.get_docstring(tree) or path.stem).splitlines()[0]
    return found


def run(name: str, title: str) -> bool:
    """Run one benchmark and write its table; whether it ended well."""
    began = time.monotonic()
    command = [sys.executable, "-m", f"benchmarks.{name}"]
    dropped = "_NUM_THREADS" if name in BARE else None  # which the Makefile sets
    environment = {key: value for key, value in os.environ.items() if dropped is None or not key.endswith(dropped)}
    done = subprocess.run(command, cwd=FOLDER.parent, env=environment, stdout=subprocess.PIPE, text=True, check=False)
    seconds = time.monotonic() - began
    ended = "" if done.returncode == 0 else f"\n\nEnded early, with exit code {done.returncode}."
    where = f"{platform.system()}, {platform.machine()}, Python {platform.python_version()}"
    text = f"## {title}\n\n`python -m benchmarks.{name}` ({seconds:.0f} s; {where})\n\n{done.stdout.strip()}{ended}\n"
    print(text, flush=True)
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / f"{name}.md").write_text(text, encoding="utf-8")
    return done.returncode == 0


def sections(text: str) -> dict[str, str]:
    """The tables in `text` by the name of the benchmark that made them."""
    parts = re.split(r"(?m)^(?=## )", text)[1:]
    named = ((re.search(r"`python -m benchmarks\.(\w+)`", part), part) for part in parts)
    return {found[1]: part.rstrip() + "\n" for found, part in named if found}


def write_page(names: Iterable[str], known: dict[str, str]) -> None:
    """docs/accuracy.md with the tables of `names` renewed; those of other benchmarks stay as they stand there."""
    tables = sections(PAGE.read_text(encoding="utf-8")) if PAGE.is_file() else {}
    tables |= {name: (OUT / f"{name}.md").read_text(encoding="utf-8") for name in names}
    PAGE.write_text("\n".join([PREFACE, *(tables[name] for name in known if name in tables)]), encoding="utf-8")


def main() -> None:
    known = benchmarks()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(known)}; default: all")
    parser.add_argument("--write", action="store_true", help="put all tables together as docs/accuracy.md")
    asked = parser.parse_args()
    unknown = [name for name in asked.names if name not in known]
    if unknown:
        parser.error(f"no benchmark {unknown[0]}; there are {', '.join(known)}")
    names = asked.names or list(known)
    failed = [name for name in names if not run(name, known[name])]
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")
    if asked.write:
        write_page(names, known)


if __name__ == "__main__":
    main()
