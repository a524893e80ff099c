"""`python -m benchmarks [NAME ...] [--write]`: run every benchmark (or those named), each in its own process.

A benchmark is a module of this folder with a `main()` that prints Markdown. What it prints goes to the screen and to
out/benchmarks/NAME.md, under the module's own first line and the command that makes it again. With --write it also
replaces benchmarks/notes/NAME.md, whose part "Remarks" is kept. docs/accuracy.md, the summary, is written by hand:
check that it still agrees.
"""

from __future__ import annotations

import argparse
import ast
import os
import platform
import subprocess
import sys
import time
from pathlib import Path

FOLDER = Path(__file__).parent
OUT = FOLDER.parent / "out" / "benchmarks"
# Run as a user would: onebend sees to the BLAS threads itself.
BARE = ("online", "one_recording", "reach", "shape", "loop", "startup", "mechanics", "free_vibration", "studio")
NOTES = FOLDER / "notes"
REMARKS = "\n## Remarks\n"


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
    head = f"# {title.rstrip('.')}\n\n`python -m benchmarks.{name}` ({seconds:.0f} s; {where})"
    text = f"{head}\n\n{done.stdout.strip()}{ended}\n"
    print(text, flush=True)
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / f"{name}.md").write_text(text, encoding="utf-8")
    return done.returncode == 0


def write_page(page: Path, tables: str) -> None:
    """The page of one benchmark with new tables; remarks that stand below them stay."""
    remarks = page.read_text(encoding="utf-8").partition(REMARKS)[2] if page.is_file() else ""
    page.write_text(tables + (REMARKS + remarks if remarks else ""), encoding="utf-8")


def main() -> None:
    known = benchmarks()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(known)}; default: all")
    parser.add_argument("--write", action="store_true", help="renew their notes in benchmarks/notes")
    asked = parser.parse_args()
    unknown = [name for name in asked.names if name not in known]
    if unknown:
        parser.error(f"no benchmark {unknown[0]}; there are {', '.join(known)}")
    names = asked.names or list(known)
    failed = [name for name in names if not run(name, known[name])]
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")
    if asked.write:
        for name in names:
            write_page(NOTES / f"{name}.md", (OUT / f"{name}.md").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
