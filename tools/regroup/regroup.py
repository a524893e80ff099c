#!/usr/bin/env python3
# ruff: noqa
"""Merges modules and moves packages of a tree by a plan: regroup.py ROOT [--plan plan.py] [--dry].

ROOT is a checkout; src/onebend, tests, benchmarks, examples, tools, docs and the files at its top are rewritten in place.
It makes fewer and deeper modules of src/onebend: a core and four wings (live, many, lab, studio), which nothing imports.
It is run once and removed with its plan. Copy both out of the checkout before, as it rewrites tools/ too.
Run it on a clean checkout; it prints every decision that it took by itself (automatic names, unplanned modules, cycles).
"""

from __future__ import annotations

import argparse
import ast
import builtins
import fnmatch
import importlib.util
import re
import shutil
import subprocess
import sys
import textwrap
from collections import defaultdict
from pathlib import Path

PKG = "onebend"
CODE_DIRS = ("tests", "benchmarks", "examples", "tools", "docs")
TEXT_SUFFIXES = {
    ".md",
    ".toml",
    ".json",
    ".py",
    ".html",
    ".js",
    ".ts",
    ".cfg",
    ".yml",
    ".yaml",
    ".txt",
    ".sh",
    ".ipynb",
    "",
}
BUILTINS = set(dir(builtins))


def say(*words: object) -> None:
    print(*words)


# ------------------------------------------------------------------------------------------------ scopes

FUNCS = (ast.FunctionDef, ast.AsyncFunctionDef)
COMPS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)


def bound_in(nodes: list[ast.AST]) -> set[str]:
    """Names that the statements bind in their own scope."""
    names: set[str] = set()
    free: set[str] = set()

    def walk(node: ast.AST, comp: bool = False) -> None:
        if isinstance(node, (*FUNCS, ast.ClassDef)):
            if not comp:
                names.add(node.name)
            for sub in [
                *node.decorator_list,
                *(
                    node.args.defaults + [d for d in node.args.kw_defaults if d]
                    if isinstance(node, FUNCS)
                    else [*node.bases, *[k.value for k in node.keywords]]
                ),
            ]:
                walk(sub, comp)
            return
        if isinstance(node, ast.Lambda):
            return
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            for a in node.names:
                names.add(a.asname or a.name.split(".")[0])
            return
        if isinstance(node, (ast.Global, ast.Nonlocal)):
            free.update(node.names)
            return
        if isinstance(node, ast.NamedExpr):
            names.add(node.target.id)
            walk(node.value, comp)
            return
        if isinstance(node, COMPS):
            for sub in ast.iter_child_nodes(node):
                walk(sub, True)
            return
        if isinstance(node, ast.comprehension):
            walk(node.iter, True)
            for c in node.ifs:
                walk(c, True)
            return
        if isinstance(node, ast.Name) and isinstance(node.ctx, (ast.Store, ast.Del)) and not comp:
            names.add(node.id)
            return
        if isinstance(node, ast.ExceptHandler) and node.name:
            names.add(node.name)
        if isinstance(node, (ast.MatchAs, ast.MatchStar)) and node.name:
            names.add(node.name)
        if isinstance(node, ast.MatchMapping) and node.rest:
            names.add(node.rest)
        for sub in ast.iter_child_nodes(node):
            walk(sub, comp)

    for n in nodes:
        walk(n)
    return names - free


def comp_bound(node: ast.AST) -> set[str]:
    names: set[str] = set()
    for g in node.generators:  # type: ignore[attr-defined]
        for sub in ast.walk(g.target):
            if isinstance(sub, ast.Name):
                names.add(sub.id)
    return names


class Names(ast.NodeVisitor):
    """Every Name with the scope that it resolves to: None for the module (or builtins), else the scope's node."""

    def __init__(self, tree: ast.Module) -> None:
        self.found: list[tuple[ast.Name, ast.AST | None]] = []
        self.stack: list[tuple[str, set[str], ast.AST]] = []
        for stmt in tree.body:
            self.visit(stmt)

    def resolve(self, name: str) -> ast.AST | None:
        for i, (kind, names, node) in enumerate(reversed(self.stack)):
            if kind == "class" and i:
                continue
            if name in names:
                return node
        return None

    def visit_Name(self, node: ast.Name) -> None:
        self.found.append((node, self.resolve(node.id)))

    def func(self, node) -> None:
        for d in node.decorator_list:
            self.visit(d)
        a = node.args
        for d in [*a.defaults, *[d for d in a.kw_defaults if d]]:
            self.visit(d)
        args = [
            *a.posonlyargs,
            *a.args,
            *a.kwonlyargs,
            *([a.vararg] if a.vararg else []),
            *([a.kwarg] if a.kwarg else []),
        ]
        for arg in args:
            if arg.annotation:
                self.visit(arg.annotation)
        if node.returns:
            self.visit(node.returns)
        names = {arg.arg for arg in args} | bound_in(node.body)
        for s in ast.walk(node):
            if isinstance(s, ast.Global):
                names -= set(s.names)
        self.stack.append(("func", names, node))
        for s in node.body:
            self.visit(s)
        self.stack.pop()

    visit_FunctionDef = func
    visit_AsyncFunctionDef = func

    def visit_Lambda(self, node: ast.Lambda) -> None:
        a = node.args
        for d in [*a.defaults, *[d for d in a.kw_defaults if d]]:
            self.visit(d)
        args = [
            *a.posonlyargs,
            *a.args,
            *a.kwonlyargs,
            *([a.vararg] if a.vararg else []),
            *([a.kwarg] if a.kwarg else []),
        ]
        self.stack.append(("func", {x.arg for x in args}, node))
        self.visit(node.body)
        self.stack.pop()

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        for d in [*node.decorator_list, *node.bases, *[k.value for k in node.keywords]]:
            self.visit(d)
        self.stack.append(("class", bound_in(node.body), node))
        for s in node.body:
            self.visit(s)
        self.stack.pop()

    def comp(self, node) -> None:
        first, *rest = node.generators
        self.visit(first.iter)
        self.stack.append(("func", comp_bound(node), node))
        self.visit(first.target)
        for c in first.ifs:
            self.visit(c)
        for g in rest:
            self.visit(g.target)
            self.visit(g.iter)
            for c in g.ifs:
                self.visit(c)
        if isinstance(node, ast.DictComp):
            self.visit(node.key)
            self.visit(node.value)
        else:
            self.visit(node.elt)
        self.stack.pop()

    visit_ListComp = visit_SetComp = visit_GeneratorExp = visit_DictComp = comp


# ------------------------------------------------------------------------------------------------ files


class File:
    """A Python file, its tree, and edits by byte offset."""

    def __init__(self, path: Path, text: str | None = None) -> None:
        self.path = path
        self.text = path.read_text(encoding="utf-8") if text is None else text
        self.data = self.text.encode()
        self.tree = ast.parse(self.text)
        self.starts = [0]
        for line in self.data.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))
        self.edits: list[tuple[int, int, bytes]] = []
        self.names = Names(self.tree).found
        self.parents: dict[ast.AST, ast.AST] = {}
        for node in ast.walk(self.tree):
            for child in ast.iter_child_nodes(node):
                self.parents[child] = node

    def at(self, line: int, col: int) -> int:
        return self.starts[line - 1] + col

    def span(self, node) -> tuple[int, int]:
        return self.at(node.lineno, node.col_offset), self.at(node.end_lineno, node.end_col_offset)

    def lines_span(self, node) -> tuple[int, int]:
        """The whole lines of a statement, with a comment behind it."""
        return self.starts[node.lineno - 1], self.starts[node.end_lineno]

    def edit(self, start: int, end: int, new: str) -> None:
        self.edits.append((start, end, new.encode()))

    def source(self, node) -> str:
        a, b = self.span(node)
        return self.data[a:b].decode()

    def rename_name(self, node: ast.Name, new: str) -> None:
        a, b = self.span(node)
        if self.data[a:b].decode() != node.id:
            raise SystemExit(f"{self.path}:{node.lineno}: place of {node.id} not found (f-string?)")
        self.edit(a, b, new)

    def result(self, start: int = 0, end: int | None = None) -> str:
        end = len(self.data) if end is None else end
        out, pos = [], start
        for a, b, new in sorted(set(self.edits)):
            if a < start or b > end:
                continue
            if a < pos:
                continue  # inside something that was replaced already
            out += [self.data[pos:a], new]
            pos = b
        out.append(self.data[pos:end])
        return b"".join(out).decode()

    def enclosing(self, node: ast.AST) -> ast.AST | None:
        while node in self.parents:
            node = self.parents[node]
            if isinstance(node, FUNCS):
                return node
        return None


def is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def doc_of(tree: ast.Module):
    if (
        tree.body
        and isinstance(tree.body[0], ast.Expr)
        and isinstance(tree.body[0].value, ast.Constant)
        and isinstance(tree.body[0].value.value, str)
    ):
        return tree.body[0]
    return None


# ------------------------------------------------------------------------------------------------ the plan


class Plan:
    def __init__(self, root: Path, plan) -> None:
        self.root, self.src = root, root / "src" / PKG
        self.modules: dict[str, Path] = {}
        for p in sorted(self.src.rglob("*.py")):
            parts = p.relative_to(self.src).with_suffix("").parts
            name = ".".join((PKG, *parts))
            self.modules[name.removesuffix(".__init__")] = p
        self.is_pkg = {m for m, p in self.modules.items() if p.name == "__init__.py"}
        self.plan = plan
        self.target: dict[str, str] = {}
        self.sources: dict[str, list[str]] = {}
        planned = {m.rstrip("!") for ms in plan.MERGE.values() for m in ms if "*" not in m}
        planned = {f"{PKG}.{m}" for m in planned}
        for target, ms in plan.MERGE.items():
            t = f"{PKG}.{target}"
            got: list[str] = []
            for m in ms:
                full = f"{PKG}.{m}"
                if "*" in m:
                    found = [
                        x
                        for x in self.modules
                        if fnmatch.fnmatch(x, full)
                        and x.count(".") == full.count(".")
                        and x not in self.is_pkg
                        and x not in planned
                        and x not in self.target
                    ]
                    if not found:
                        say("note: nothing for", m)
                elif full in self.modules:
                    found = [full]
                else:
                    say("note: planned module is not there:", m)
                    found = []
                for x in found:
                    if x in self.target:
                        raise SystemExit(f"{x} is planned twice: {self.target[x]} and {t}")
                    self.target[x] = t
                    got.append(x)
            if got:
                self.sources[t] = got
        # packages that move as a whole: old prefix -> new prefix
        for m in self.modules:
            if m in self.target:
                continue
            for old, new in plan.MOVE.items():
                o, n = f"{PKG}.{old}", f"{PKG}.{new}"
                if m == o or m.startswith(o + "."):
                    t = n + m[len(o) :]
                    if m in self.is_pkg and self.only_doc(m) and m != o and not self.stays(m):
                        break
                    self.target[m] = t
                    self.sources[t] = [m]
                    break
        for m in self.modules:
            if m not in self.target:
                if m in self.is_pkg and m != PKG and self.only_doc(m) and not self.stays(m):
                    continue  # the folder goes
                if self.short(m) in plan.PKG_MOVE:
                    continue  # its face is made anew
                self.target[m] = m
                self.sources[m] = [m]
        # a package `__init__` that vanishes but is named as target elsewhere
        self.gone = [m for m in self.modules if m not in self.target]
        self.new_pkgs = {".".join(t.split(".")[:i]) for t in self.sources for i in range(1, t.count(".") + 1)}
        self.new_pkgs |= {f"{PKG}.{t}" for t in plan.PACKAGES}
        for old, new in plan.PKG_MOVE.items():
            if f"{PKG}.{old}" not in self.target:
                self.target[f"{PKG}.{old}"] = f"{PKG}.{new}"

    @staticmethod
    def short(m: str) -> str:
        return m.removeprefix(PKG + ".")

    def only_doc(self, m: str) -> bool:
        tree = ast.parse(self.modules[m].read_text(encoding="utf-8"))
        return len(tree.body) <= 1 and (not tree.body or doc_of(tree) is not None)

    def stays(self, pkg: str) -> bool:
        """Whether some module stays in (or comes to) the package of this name, so that its `__init__` is needed."""
        return any(t.startswith(pkg + ".") for t in self.target.values()) or any(
            m.startswith(pkg + ".") and m not in self.target for m in self.modules if m not in self.is_pkg
        )


def split(root: Path, plan) -> None:
    """Some definitions of a module, with what only they use, into a module of their own: the plan's SPLIT."""
    src = root / "src" / PKG
    moved: dict[tuple[str, str], str] = {}
    for old, parts in getattr(plan, "SPLIT", {}).items():
        path = src / (old.replace(".", "/") + ".py")
        if not path.exists():
            path = src / old.replace(".", "/") / "__init__.py"
        if not path.exists():
            say("note: SPLIT: not there:", old)
            continue
        for new, wanted in parts.items():
            f = File(path)
            defs = Regroup.defs_of(f)
            uses = {
                name: {n.id for n in ast.walk(stmt) if isinstance(n, ast.Name)} & set(defs) - {name}
                for name, stmt in defs.items()
            }
            take = {name for name in wanted if name in defs}
            if missing := set(wanted) - take:
                say("note: SPLIT: names are not there:", old, missing)
            while True:
                rest = set(defs) - take
                used_by_rest = set().union(*(uses[n] for n in rest)) | {
                    n.id
                    for s in f.tree.body
                    for n in ast.walk(s)
                    if isinstance(n, ast.Name) and not any(s is defs[d] for d in defs)
                }
                more = {n for t in take for n in uses[t]} - take - used_by_rest
                if not more:
                    break
                take |= more
            needed = {n for t in take for n in uses[t]} - take
            back = {n for r in set(defs) - take for n in uses[r]} & take
            head = "".join(
                f.data[slice(*f.lines_span(s))].decode()
                for s in f.tree.body
                if isinstance(s, (ast.Import, ast.ImportFrom)) or is_type_checking(s)
            )
            doc = f.source(doc_of(f.tree))
            body = []
            for s in f.tree.body:
                mine = [d for d in defs if defs[d] is s]
                if mine and set(mine) <= take:
                    a, b = f.lines_span(s)
                    if getattr(s, "decorator_list", None):
                        a = f.starts[s.decorator_list[0].lineno - 1]
                    while a and f.data[:a].splitlines(keepends=True)[-1].lstrip().startswith(b"#"):
                        a -= len(f.data[:a].splitlines(keepends=True)[-1])
                    body.append(f.data[a:b].decode())
                    f.edit(a, b, "")
            home = f"{PKG}.{old}"
            if needed:
                head += f"from {home} import {', '.join(sorted(needed))}\n"
            (src / (new.replace(".", "/") + ".py")).write_text(
                f"{doc}\n\n{head}\n\n" + "\n\n".join(body), encoding="utf-8"
            )
            if back:
                last = [s for s in f.tree.body if isinstance(s, (ast.Import, ast.ImportFrom))][-1]
                at = f.lines_span(last)[1]
                f.edit(at, at, f"from {PKG}.{new} import {', '.join(sorted(back))}\n")
            path.write_text(f.result(), encoding="utf-8")
            subprocess.run(
                [
                    Path(sys.executable).with_name("ruff"),
                    "check",
                    "-q",
                    "--fix",
                    "--select",
                    "F401",
                    "--isolated",
                    path,
                    src / (new.replace(".", "/") + ".py"),
                ],
                check=False,
            )
            for name in take:
                moved[(home, name)] = f"{PKG}.{new}"
    if not moved:
        return
    plan.SPLIT_HOME = moved
    for base in ("src", *CODE_DIRS):
        for path in sorted((root / base).rglob("*.py")):
            f = File(path)
            for node in ast.walk(f.tree):
                if isinstance(node, ast.ImportFrom) and any((node.module, a.name) in moved for a in node.names):
                    lines: dict[str, list[str]] = defaultdict(list)
                    for a in node.names:
                        lines[moved.get((node.module, a.name), node.module)].append(
                            a.name + (f" as {a.asname}" if a.asname else "")
                        )
                    a, b = f.span(node)
                    f.edit(
                        a,
                        b,
                        f"\n{' ' * node.col_offset}".join(
                            f"from {m} import {', '.join(ns)}" for m, ns in lines.items()
                        ),
                    )
            if f.edits:
                path.write_text(f.result(), encoding="utf-8")


class Regroup:
    def __init__(self, root: Path, plan) -> None:
        self.p = Plan(root, plan)
        self.plan = plan
        self.root = root
        self.files = {m: File(path) for m, path in self.p.modules.items()}
        self.rename: dict[tuple[str, str], str] = {}
        self.dropped: set[tuple[str, str]] = set()
        self.alias: dict[tuple[str, str], str] = {}  # (source, local import name) -> other local name
        self.moved_public: dict[tuple[str, str], tuple[str, str]] = {}
        self.defs: dict[str, dict[str, ast.stmt]] = {m: self.defs_of(f) for m, f in self.files.items()}
        for key, new in plan.RENAME.items():
            m, name = key.rsplit(".", 1)
            m = f"{PKG}.{m}"
            if m not in self.defs or name not in self.defs[m]:
                say("note: name of the plan is not there:", key)
                continue
            self.rename[(m, name)] = new
        for t, ms in self.p.sources.items():
            if len(ms) > 1:
                self.p.sources[t] = self.ordered(t, ms)
        for t, ms in self.p.sources.items():
            if len(ms) > 1:
                self.clashes(t, ms)
        self.faces: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
        for m in sorted(self.p.is_pkg | {f"{PKG}.{x}" for x in plan.FACADES}):
            if m in self.files:
                self.collect_face(m)

    def collect_face(self, m: str) -> None:
        """The public names of a package or facade: which package shows them afterwards."""
        f = self.files[m]
        facade = self.short(m) in self.plan.FACADES
        block = next((s for s in f.tree.body if is_type_checking(s) and s.orelse), None)
        stmts = (
            [s for s in f.tree.body if isinstance(s, ast.ImportFrom) and s.module != "__future__"]
            if facade
            else (block.body if block else [])
        )
        for s in stmts:
            for a in s.names:
                if f"{s.module}.{a.name}" in self.p.modules:
                    continue
                home = self.p.target.get(s.module, s.module)
                name = self.rename.get((s.module, a.name), a.name)
                top = home.split(".")[1]
                shown = f"{PKG}.{top}" if top in self.plan.WINGS or facade else m
                self.faces[shown][home].add(name)
                if shown != m:
                    self.moved_public[(m, a.name)] = (shown, name)

    def face_text(self, pkg: str, indent: str = "") -> tuple[str, str]:
        """The type-checking imports of a face, and its dict."""
        homes = self.faces.get(pkg, {})
        checking = "".join(
            f"    from {h} import {', '.join(f'{n} as {n}' for n in sorted(ns))}\n" for h, ns in sorted(homes.items())
        )
        table = "{\n"
        for h, ns in sorted(homes.items()):
            names = " ".join(sorted(ns))
            if len(names) + len(h) < 98:
                table += f'            "{h}": "{names}",\n'
            else:
                lines = textwrap.wrap(names, 96)
                table += (
                    f'            "{h}": (\n'
                    + "".join(
                        f'                "{line}{" " if i < len(lines) - 1 else ""}"\n' for i, line in enumerate(lines)
                    )
                    + "            ),\n"
                )
        return checking, table + "        }"

    @staticmethod
    def defs_of(f: File) -> dict[str, ast.stmt]:
        found: dict[str, ast.stmt] = {}

        def take(stmts):
            for s in stmts:
                if isinstance(s, (*FUNCS, ast.ClassDef)):
                    found[s.name] = s
                elif isinstance(s, (ast.Import, ast.ImportFrom)) or is_type_checking(s):
                    pass
                elif isinstance(s, (ast.If, ast.Try, ast.With, ast.For)):
                    for n in bound_in([s]):
                        found.setdefault(n, s)
                else:
                    for n in bound_in([s]):
                        found[n] = s

        take(f.tree.body)
        return found

    # -------------------------------------------------------------- what an import is of

    def resolve(self, module: str, name: str) -> tuple[str, str | None]:
        """(old module, None) for a module, (old module, name) for a name in one."""
        full = f"{module}.{name}"
        if (module, name) in self.moved_public:
            return (module, name)
        if full in self.p.modules:
            return full, None
        if module in self.p.is_pkg and name in self.lazy_home(module):
            return module, name
        return module, name

    def lazy_home(self, module: str):
        return ()

    def internal(self, module: str | None) -> bool:
        return bool(module) and (module == PKG or module.startswith(PKG + "."))

    def imports_of(self, f: File):
        """(statement, alias, type-checking, function) for all imports of the package."""
        for node in ast.walk(f.tree):
            if isinstance(node, ast.ImportFrom) and self.internal(node.module):
                yield node
            elif isinstance(node, ast.Import) and any(self.internal(a.name) for a in node.names):
                yield node

    def needs(self, m: str) -> set[str]:
        """Old modules that a module imports."""
        out = set()
        for node in self.imports_of(self.files[m]):
            if isinstance(node, ast.ImportFrom):
                for a in node.names:
                    out.add(self.resolve(node.module, a.name)[0])
            else:
                out |= {a.name for a in node.names}
        return out

    def ordered(self, t: str, ms: list[str]) -> list[str]:
        left, out = list(ms), []
        needs = {m: self.needs(m) & set(ms) - {m} for m in ms}
        while left:
            for m in left:
                if not needs[m] & set(left) - {m}:
                    break
            else:
                raise SystemExit(f"cycle inside {t}: {left}")
            out.append(m)
            left.remove(m)
        self.lead = getattr(self, "lead", {})
        self.lead[t] = ms[0]
        return out

    # -------------------------------------------------------------- clashes

    def top_imports(self, m: str) -> dict[str, tuple]:
        """Local name -> origin, of imports at the top of a module, type-checking ones too."""
        f = self.files[m]
        found: dict[str, tuple] = {}
        for node in ast.walk(f.tree):
            if not isinstance(node, (ast.Import, ast.ImportFrom)) or f.enclosing(node) is not None:
                continue
            if node not in f.tree.body and not is_type_checking(f.parents[node]):
                continue
            for a in node.names:
                if isinstance(node, ast.Import):
                    found[a.asname or a.name.split(".")[0]] = ("import", a.name if a.asname else a.name.split(".")[0])
                elif self.internal(node.module):
                    om, on = self.resolve(node.module, a.name)
                    found[a.asname or a.name] = ("internal", om, on)
                elif node.module != "__future__":
                    found[a.asname or a.name] = ("from", node.module, a.name)
        return found

    def text_of(self, m: str, name: str) -> str:
        f = self.files[m]
        a, b = f.lines_span(self.defs[m][name])
        node = self.defs[m][name]
        if getattr(node, "decorator_list", None):
            a = f.starts[node.decorator_list[0].lineno - 1]
        return f.data[a:b].decode().strip()

    def clashes(self, t: str, ms: list[str]) -> None:
        origins: dict[str, dict[tuple, list[str]]] = defaultdict(lambda: defaultdict(list))
        for m in ms:
            for name in self.defs[m]:
                new = self.rename.get((m, name), name)
                origins[new][("def", m, name)].append(m)
            for name, o in self.top_imports(m).items():
                if o[0] == "internal" and self.p.target.get(o[1]) == t:
                    continue  # drops out, uses follow the definition
                if o[0] == "internal":
                    local = name
                    if o[2] is not None and name == o[2]:
                        local = self.rename.get((o[1], o[2]), name)
                    o = (
                        "internal",
                        self.p.target.get(o[1], o[1]),
                        self.rename.get((o[1], o[2]), o[2]) if o[2] else None,
                    )
                    origins[local][o].append(m)
                else:
                    origins[name][o].append(m)
        taken = set(origins)
        for name, where in sorted(origins.items()):
            if len(where) < 2:
                continue
            defs = [o for o in where if o[0] == "def"]
            imports = [o for o in where if o[0] != "def"]
            # equal definitions become one
            if len(defs) > 1:
                first: dict[str, tuple] = {}
                for o in defs:
                    text = self.text_of(o[1], o[2])
                    same = getattr(self.plan, "SAME", {}).get(f"{self.short(o[1])}.{o[2]}")
                    if same is not None:
                        om, on = f"{PKG}.{same}".rsplit(".", 1)
                        text = self.text_of(om, on)
                    if text in first and not isinstance(self.defs[o[1]][o[2]], (ast.If, ast.Try)):
                        keep = first[text]
                        self.dropped.add((o[1], o[2]))
                        self.rename[(o[1], o[2])] = self.rename.get((keep[1], keep[2]), keep[2])
                        say(
                            f"one definition: {t}: {name} of {self.short(o[1])} is that of {self.short(keep[1])}: {text.splitlines()[0][:80]}"
                        )
                    else:
                        first[text] = o
                defs = list(first.values())
            stays = None
            if not imports and not any((o[1], o[2]) in self.rename for o in defs):
                public = [o for o in defs if not name.startswith("_")]
                stays = (public or defs)[0] if len(defs) == 1 or public else None
            elif len(defs) == 1 and not imports:
                stays = defs[0]
            if len(defs) == 1 and imports:
                # the import gets another local name, unless the definition is private
                o = defs[0]
                if name.startswith("_"):
                    self.auto(t, o, taken)
                    continue
                stays = o
            if len(defs) > 1 and imports:
                stays = None
            for o in defs:
                if o is not stays and len(defs) + len(imports) > 1:
                    self.auto(t, o, taken)
            if imports and (defs or len(imports) > 1):
                keep_first = None if stays else max(imports, key=lambda o: len(where[o]))
                for o in imports:
                    if o is keep_first:
                        continue
                    for m in where[o]:
                        base = (o[1] or "").rsplit(".", 1)[-1]
                        new = f"{base}_{name}"
                        new = getattr(self.plan, "ALIAS", {}).get(f"{self.short(m)}.{name}", new)
                        self.alias[(m, name)] = new
                        say(f"ALIAS {t}: import of {name} from {o[1]} in {self.short(m)} -> {new}")

    def auto(self, t: str, o: tuple, taken: set[str]) -> None:
        _, m, name = o
        base = m.rsplit(".", 1)[-1]
        bare = name.lstrip("_")
        lead = "_" if name.startswith("_") else ""
        if bare.isupper() or re.fullmatch(r"[A-Z0-9_]+", bare):
            new = f"{lead}{base.upper()}_{bare}"
        elif bare[:1].isupper():
            new = f"{lead}{''.join(w.title() for w in base.split('_'))}{bare}"
        else:
            new = f"{lead}{base}_{bare}"
        if (m, name) in self.rename:
            new = self.rename[(m, name)] + "_2"
        while new in taken:
            new += "_"
        taken.add(new)
        self.rename[(m, name)] = new
        say(f'AUTO {t}: "{self.short(m)}.{name}": "{new}",   # {self.text_of(m, name).splitlines()[0][:100]}')

    @staticmethod
    def short(m: str) -> str:
        return m.removeprefix(PKG + ".")

    # -------------------------------------------------------------- one file rewritten

    def base(self, module: str) -> str:
        return module.rsplit(".", 1)[-1]

    def rewrite(self, f: File, here: str | None) -> dict:
        """Edits of one file; `here` is its target module, None outside the package. Returns its top imports, if inside."""
        old_here = None
        for m, g in self.files.items():
            if g is f:
                old_here = m
        collected: list[tuple[str, str, str | None, str | None, bool]] = []
        bindings: dict[tuple[ast.AST | None, str], tuple[str, str | None, str]] = {}
        idents = {n.id for n, _ in f.names} | set(re.findall(r"[A-Za-z_]\w*", f.text))
        merging = here is not None and len(self.p.sources.get(here, ())) > 1
        for node in ast.walk(f.tree):
            if not isinstance(node, (ast.Import, ast.ImportFrom)):
                continue
            scope = f.enclosing(node)
            top = scope is None and (node in f.tree.body or is_type_checking(f.parents[node]))
            checking = any(is_type_checking(f.parents.get(x)) for x in [node])
            inside = [
                a for a in node.names if self.internal(node.module if isinstance(node, ast.ImportFrom) else a.name)
            ]
            if not inside:
                if top and merging:
                    if isinstance(node, ast.ImportFrom) and node.module == "__future__":
                        continue
                    for a in node.names:
                        local = self.alias.get((old_here, a.asname or a.name), a.asname)
                        if local != a.asname:
                            bindings[(None, a.asname or a.name)] = ("", None, local)
                        if isinstance(node, ast.Import):
                            collected.append(("import", a.name, None, local, checking))
                        else:
                            collected.append(("from", node.module, a.name, local, checking))
                continue
            lines: list[str] = []
            for a in node.names:
                if isinstance(node, ast.Import):
                    new = self.p.target.get(a.name, a.name)
                    if merging and top:
                        collected.append(("import", new, None, a.asname, checking))
                    lines.append(f"import {new}" + (f" as {a.asname}" if a.asname else ""))
                    bindings[(scope, a.asname or a.name)] = (a.name, None, a.asname or new)
                    continue
                om, on = self.resolve(node.module, a.name)
                old_local = a.asname or a.name
                if (om, on) in self.moved_public:
                    nm, nn = self.moved_public[(om, on)]
                elif on is None:
                    nm, nn = self.p.target.get(om, om), None
                else:
                    nm, nn = self.p.target.get(om, om), self.rename.get((om, on), on)
                if here is not None and nm == here and merging:
                    # it is here already
                    local = nn if nn is not None else "<here>"
                    bindings[(scope, old_local)] = (om, on, local)
                    continue
                if nn is None:
                    parent, _, newbase = nm.rpartition(".")
                    local = a.asname
                    if (old_here, old_local) in self.alias and scope is None:
                        local = self.alias[(old_here, old_local)]
                    elif a.asname is None and newbase != a.name:
                        local = a.name if newbase in idents else None
                    final = local or newbase
                    stmt = ("from", parent, newbase, local if local != newbase else None, checking)
                else:
                    local = a.asname
                    if (old_here, old_local) in self.alias and scope is None:
                        local = self.alias[(old_here, old_local)]
                    elif a.asname is None and nn != a.name and nn in idents and nn not in ("",):
                        local = None
                    final = local or nn
                    if a.asname is not None and a.asname == a.name and on is not None:
                        local = final = nn  # `x as x`: shown
                    stmt = (
                        "from",
                        nm,
                        nn,
                        local if (local != nn or (a.asname and a.asname == a.name)) else None,
                        checking,
                    )
                bindings[(scope, old_local)] = (om, on, final)
                if merging and top:
                    collected.append(stmt)
                lines.append(f"from {stmt[1]} import {stmt[2]}" + (f" as {stmt[3]}" if stmt[3] else ""))
            if not (merging and top):
                a, b = f.span(node)
                indent = " " * node.col_offset
                if lines:
                    grouped: dict[str, list[str]] = {}
                    for line in lines:
                        if line.startswith("from "):
                            mod, _, what = line[5:].partition(" import ")
                            grouped.setdefault(mod, []).append(what)
                        else:
                            grouped.setdefault(line, [])
                    texts = [f"from {k} import {', '.join(v)}" if v else k for k, v in grouped.items()]
                    f.edit(a, b, f"\n{indent}".join(texts))
                else:
                    a, b = f.lines_span(node)
                    f.edit(a, b, "")
        # uses
        own = (
            {
                name: self.rename[(old_here, name)]
                for name in self.defs.get(old_here, {})
                if (old_here, name) in self.rename
            }
            if old_here
            else {}
        )
        for node, scope in f.names:
            if isinstance(f.parents.get(node), ast.Attribute):
                attr = f.parents[node]
            else:
                attr = None
            key = (scope, node.id)
            if scope is not None and key not in bindings:
                continue
            if key in bindings:
                om, on, final = bindings[key]
                if on is None and om and attr is not None:
                    new = self.rename.get((om, attr.attr), attr.attr)
                    if final == "<here>":
                        outer = f.enclosing(attr)
                        if outer is not None and new in bound_in(outer.body):
                            say(
                                f"HAND {f.path}:{node.lineno}: {new} of a module that stands here now is hidden by a local name"
                            )
                        a, b = f.span(attr)
                        f.edit(a, b, new)
                        continue
                    if new != attr.attr:
                        a, b = f.span(attr)
                        f.edit(b - len(attr.attr.encode()), b, new)
                if final == "<here>":
                    say(f"HAND {f.path}:{node.lineno}: module {node.id} is used as a value, but stands here now")
                elif final != node.id and "." not in final and "." not in node.id:
                    f.rename_name(node, final)
            elif node.id in own:
                f.rename_name(node, own[node.id])
        for name, new in own.items():
            stmt = self.defs[old_here][name]
            if isinstance(stmt, (*FUNCS, ast.ClassDef)):
                line_start = f.at(stmt.lineno, stmt.col_offset)
                match = re.compile(rb"(async\s+)?(def|class)\s+").match(f.data, line_start)
                f.edit(match.end(), match.end() + len(name.encode()), new)
        for node in ast.walk(f.tree):
            if isinstance(node, ast.Global):
                for n in node.names:
                    if n in own:
                        say(f"HAND {f.path}:{node.lineno}: global {n} is {own[n]} now")
        # monkeypatch.setattr(module, "name", ...) and ("onebend.a.b.name", ...)
        for node in ast.walk(f.tree):
            if (
                isinstance(node, ast.Call)
                and len(node.args) >= 2
                and isinstance(node.args[0], ast.Name)
                and isinstance(node.args[1], ast.Constant)
                and isinstance(node.args[1].value, str)
            ):
                for (scope, local), (om, on, _) in bindings.items():
                    if local == node.args[0].id and on is None and om and (om, node.args[1].value) in self.rename:
                        a, b = f.span(node.args[1])
                        f.edit(a, b, f'"{self.rename[(om, node.args[1].value)]}"')
        return {"imports": collected, "bindings": bindings}

    # -------------------------------------------------------------- one merged module

    def comment(self, text: str) -> str:
        out = []
        for para in text.strip().split("\n\n"):
            para = textwrap.dedent(para)
            lines = para.split("\n")
            if any(len(line) > 116 for line in lines):
                lines = textwrap.wrap(
                    " ".join(line.strip() for line in lines), 116, break_long_words=False, break_on_hyphens=False
                )
            out.append("\n".join(f"# {line}".rstrip() for line in lines))
        return "\n#\n".join(out)

    def merged(self, t: str) -> str:
        ms = self.p.sources[t]
        lead = self.lead[t]
        collected, bodies = [], []
        docs = self.plan.DOC
        lead_doc = doc_of(self.files[lead].tree)
        old_pkg = t if t in self.p.is_pkg and t in self.p.gone else None
        text = docs.get(self.short(t))
        pkg_doc = doc_of(self.files[old_pkg].tree) if old_pkg else None
        lead_comment = False
        if text is None:
            text = ast.literal_eval(self.files[lead].source(lead_doc)) if lead_doc else ""
            if pkg_doc is not None and len(ms) > 1:
                text = ast.literal_eval(self.files[old_pkg].source(pkg_doc))
                lead_comment = True
        else:
            lead_comment = self.short(t) not in getattr(self.plan, "DOC_WHOLE", ())
        raw = "\\" in text
        for m in ms:
            f = self.files[m]
            info = self.rewrite(f, t)
            collected += info["imports"]
            for stmt in f.tree.body:
                if stmt is doc_of(f.tree) or isinstance(stmt, (ast.Import, ast.ImportFrom)):
                    a, b = f.lines_span(stmt)
                    f.edit(a, b, "")
                elif is_type_checking(stmt):
                    if stmt.orelse or not all(isinstance(x, (ast.Import, ast.ImportFrom)) for x in stmt.body):
                        say(f"HAND {m}: TYPE_CHECKING block is not plain")
                    a, b = f.lines_span(stmt)
                    f.edits = [e for e in f.edits if not a <= e[0] < b]
                    f.edit(a, b, "")
            for om, name in self.dropped:
                if om == m:
                    stmt = self.defs[m][name]
                    a, b = f.lines_span(stmt)
                    if getattr(stmt, "decorator_list", None):
                        a = f.starts[stmt.decorator_list[0].lineno - 1]
                    f.edits = [e for e in f.edits if not a <= e[0] < b]
                    f.edit(a, b, "")
            body = f.result().strip("\n")
            d = doc_of(f.tree)
            head = ""
            if d is not None and (m != lead or lead_comment) and self.short(m) not in self.plan.NO_COMMENT:
                head = self.comment(ast.literal_eval(f.source(d))) + "\n\n"
            bodies.append(f"{head}{body}\n")
        runtime = [c for c in collected if not c[4]]
        have = {c[:4] for c in runtime}
        checking = sorted({c[:4] for c in collected if c[4] and c[:4] not in have}, key=str)
        names_runtime = set(have)
        imports = self.import_text(sorted(names_runtime, key=str))
        out = (
            f'"""{text}"""\n\nfrom __future__ import annotations\n\n'
            if not raw
            else f'r"""{text}"""\n\nfrom __future__ import annotations\n\n'
        )
        out += imports
        if checking:
            out += "\nif TYPE_CHECKING:\n" + textwrap.indent(self.import_text(checking), "    ")
        return out + "\n\n" + "\n\n".join(bodies)

    @staticmethod
    def import_text(items) -> str:
        plain, by, single = [], defaultdict(list), []
        for kind, module, name, local in items:
            if kind == "import":
                plain.append(f"import {module}" + (f" as {local}" if local else ""))
            else:
                by[module].append(name + (f" as {local}" if local else ""))
        return "".join(line + "\n" for line in plain) + "".join(
            f"from {m} import {', '.join(sorted(set(ns)))}\n" for m, ns in sorted(by.items())
        )

    # -------------------------------------------------------------- faces: packages whose names are lazy

    def face(self, pkg: str, text: str) -> str:
        """The package's lazy names made again: one `from` a module, and the dict of the same."""
        f = File(Path("face"), text)
        checking, table = self.face_text(pkg)
        block = next((s for s in f.tree.body if is_type_checking(s) and s.orelse), None)
        if block is None:
            if pkg not in self.faces and pkg not in self.commands:
                return text
            out = text.rstrip() + "\n\nfrom __future__ import annotations\n\n"
            if pkg in self.faces:
                out += "from typing import TYPE_CHECKING\n\n"
            names = [n for n, there in (("Place", pkg in self.commands), ("lazy_names", pkg in self.faces)) if there]
            out += f"from {PKG}.lazy import {', '.join(names)}\n\n"
            if pkg in self.faces:
                out += f"if TYPE_CHECKING:\n{checking}else:\n    __getattr__, __dir__, __all__ = lazy_names(\n        __name__,\n        {table},\n    )\n"
            return out + self.commands.get(pkg, "")
        call = next(n for n in ast.walk(block) if isinstance(n, ast.Call) and getattr(n.func, "id", "") == "lazy_names")
        f.edit(*f.span(call.args[1]), table)
        inner = ""
        for s in block.body:
            for a in s.names:
                full = f"{s.module}.{a.name}"
                if full in self.new_modules and full.split(".")[1] not in self.plan.WINGS:
                    inner += f"    from {s.module} import {a.name} as {a.name}\n"
        f.edit(f.lines_span(block.body[0])[0], f.lines_span(block.body[-1])[1], inner + checking)
        for k in call.keywords:
            if k.arg == "inside":
                words = [
                    w
                    for w in ast.literal_eval(f.source(k.value)).split()
                    if f"{pkg}.{w}" in self.new_modules and w not in self.plan.WINGS
                ]
                f.edit(*f.span(k.value), '"' + " ".join(words) + '"')
        out = f.result()
        if pkg in self.commands:
            out = out.replace("import lazy_names", "import Place, lazy_names").rstrip() + "\n" + self.commands[pkg]
        return out

    def take_commands(self, out: dict[str, str]) -> None:
        """The table of commands, each where its module stands now; those of wings go to the wings."""
        self.commands: dict[str, str] = {}
        f = File(Path("cli"), out[f"{PKG}.cli"])
        table = next(
            s for s in f.tree.body if isinstance(s, ast.Assign) and getattr(s.targets[0], "id", "") == "COMMANDS"
        )
        homes = getattr(self.plan, "SPLIT_HOME", {})
        entries: dict[str, str] = defaultdict(str)
        for key, value in zip(table.value.keys, table.value.values):
            module, function = ast.literal_eval(value.args[0]), ast.literal_eval(value.args[1])
            old = f"{PKG}.cli.{module}"
            new = self.p.target[homes.get((old, function), old)]
            function = self.rename.get((homes.get((old, function), old), function), function)
            top = new.split(".")[1]
            owner = f"{PKG}.{top}" if top in self.plan.WINGS else f"{PKG}.cli"
            rest = "".join(f"        {f.source(a)},\n" for a in value.args[2:])
            entries[owner] += f'    {f.source(key)}: Place(\n        "{new}",\n        "{function}",\n{rest}    ),\n'
        f.edit(*f.span(table), "COMMANDS = {\n" + entries.pop(f"{PKG}.cli") + "}")
        out[f"{PKG}.cli"] = f.result()
        for owner, text in entries.items():
            self.commands[owner] = "\nCOMMANDS = {\n" + text + "}\n"

    # -------------------------------------------------------------- text

    def text_rules(self):
        rules: list[tuple[re.Pattern[str], str]] = []
        for pattern, new in getattr(self.plan, "TEXT_FIRST", []):
            rules.append((re.compile(pattern), new))
        for (old, name), (new, other) in self.moved_public.items():
            rules.append((re.compile(rf"(?<![\w./]){re.escape(old)}\.{name}(?!\w)"), f"{new}.{other}"))
            rules.append((re.compile(rf"(?<=from ){re.escape(old)} import {name}(?=$|\n)"), f"{new} import {other}"))
        for (m, name), new in sorted(self.rename.items(), key=lambda kv: -len(kv[0][0])):
            rules.append((re.compile(rf"(?<![\w./]){re.escape(m)}\.{name}\b"), f"{self.p.target[m]}.{new}"))
            rules.append(
                (re.compile(rf"(?<=`){re.escape(self.short(m))}\.{name}\b"), f"{self.short(self.p.target[m])}.{new}")
            )
        moved = [(m, t) for m, t in self.p.target.items() if m != t]
        rules += [
            (re.compile(rf"(?<![\w./]){PKG}\.{old}(?![\w.])"), f"{PKG}.{new}")
            for old, new in self.plan.PKG_MOVE.items()
        ]
        gone = []
        for m in self.p.gone:  # a folder that goes: where most of it went
            into = [t for s, t in self.p.target.items() if s.startswith(m + ".")]
            if into:
                common = max(set(into), key=into.count)
                if common != m:
                    gone.append((m, common if m not in into else m))
        for m, t in sorted(moved, key=lambda mt: -len(mt[0])):
            rules.append((re.compile(rf"(?<![\w./]){re.escape(m)}(?![\w/])"), t))
            s, n = self.short(m), self.short(t)
            if "." in s or m in self.p.is_pkg:
                path_old, path_new = s.replace(".", "/"), n.replace(".", "/")
                if m in self.p.is_pkg:
                    rules.append(
                        (
                            re.compile(rf"(?<![\w./])(src/onebend/)?{path_old}/__init__\.py"),
                            rf"\g<1>{path_new}/__init__.py",
                        )
                    )
                else:
                    rules.append(
                        (re.compile(rf"(?<![\w.])((?:src/onebend/)?){path_old}\.py\b"), rf"\g<1>{path_new}.py")
                    )
                if "." in s:
                    rules.append((re.compile(rf"(?<=`){re.escape(s)}(?=[.`])"), n))
        return rules

    def apply_text(self, text: str, rules) -> str:
        for pattern, new in rules:
            text = pattern.sub(new, text)
        return text

    # -------------------------------------------------------------- all

    def run(self) -> None:
        p = self.p
        self.new_modules = set(p.sources) | p.new_pkgs
        out: dict[str, str] = {}
        for t, ms in sorted(p.sources.items()):
            if len(ms) > 1:
                out[t] = self.merged(t)
            else:
                f = self.files[ms[0]]
                self.rewrite(f, t)
                out[t] = f.result()
                doc = self.plan.DOC.get(self.short(t))
                if doc is not None and doc_of(ast.parse(out[t])) is not None:
                    g = File(Path(t), out[t])
                    a, b = g.span(doc_of(g.tree))
                    g.edit(a, b, f'"""{doc}"""')
                    out[t] = g.result()
        rules = self.text_rules()
        for t in out:
            out[t] = self.apply_text(out[t], rules)
        others: dict[Path, str] = {}
        for d in CODE_DIRS:
            for path in sorted((self.root / d).rglob("*.py")):
                f = File(path)
                self.rewrite(f, None)
                others[path] = self.apply_text(f.result(), rules)
        for base in [self.root, *(self.root / d for d in (*CODE_DIRS, "web"))]:
            for path in sorted(base.glob("*") if base == self.root else base.rglob("*")):
                if (
                    not path.is_file()
                    or path.suffix == ".py"
                    or path.suffix not in TEXT_SUFFIXES
                    or "node_modules" in path.parts
                    or "images" in path.parts
                ):
                    continue
                if path.stat().st_size > 2_000_000 or path.name.startswith(".git"):
                    continue
                try:
                    text = path.read_text(encoding="utf-8")
                except UnicodeDecodeError:
                    continue
                new = self.apply_text(text, rules)
                if new != text:
                    others[path] = new
        # write
        data = [q for q in p.src.rglob("*") if q.is_file() and q.suffix != ".py" and "__pycache__" not in q.parts]
        kept = {q: q.read_bytes() for q in data}
        for m, path in p.modules.items():
            path.unlink()
        for q in data:
            q.unlink()
        for pkg in sorted(p.new_pkgs):
            if pkg not in out:
                out[pkg] = f'"""{self.plan.DOC.get(self.short(pkg), "")}"""\n'
                if not self.plan.DOC.get(self.short(pkg)):
                    say("HAND: new package without a docstring in DOC:", pkg)
        self.take_commands(out)
        for t, text in out.items():
            rel = Path(*t.split(".")[1:]) if t != PKG else Path()
            path = p.src / rel / "__init__.py" if t in p.new_pkgs or t == PKG else p.src / rel.with_suffix(".py")
            if t in p.new_pkgs or t == PKG:
                text = self.face(t, text)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        for q, content in kept.items():
            rel = q.relative_to(p.src)
            for old, new in self.plan.DATA.items():
                if str(rel).startswith(old):
                    rel = Path(new + str(rel)[len(old) :])
                    break
            (p.src / rel).parent.mkdir(parents=True, exist_ok=True)
            (p.src / rel).write_bytes(content)
        for path, text in others.items():
            path.write_text(text, encoding="utf-8")
        for d in sorted(p.src.rglob("*"), key=lambda q: -len(q.parts)):
            if d.is_dir() and d.name == "__pycache__":
                shutil.rmtree(d)
        for d in sorted(p.src.rglob("*"), key=lambda q: -len(q.parts)):
            if d.is_dir() and not any(d.iterdir()):
                d.rmdir()
        went: dict[str, str] = {}
        for old, new in self.plan.TEST_MOVE.items():
            for a in sorted(self.root.glob(old)):
                if not a.is_file():
                    continue
                target = self.root / new / a.name if new.endswith("/") else self.root / new
                if target.exists() and a.name == "__init__.py":
                    a.unlink()
                    continue
                if target.exists():
                    say("HAND: a test file of this name is there already:", a, target)
                    continue
                target.parent.mkdir(parents=True, exist_ok=True)
                a.rename(target)
                went[str(a.relative_to(self.root))] = str(target.relative_to(self.root))
        tests = []
        for x, y in sorted(went.items(), key=lambda xy: -len(xy[0])):
            if x.endswith(".py"):
                tests.append((re.compile(rf"\b{re.escape(x[:-3].replace('/', '.'))}\b"), y[:-3].replace("/", ".")))
                tests.append(
                    (
                        re.compile(
                            rf"(?<=from ){re.escape(str(Path(x).parent).replace('/', '.'))}(?= import {Path(x).stem}\b)"
                        ),
                        str(Path(y).parent).replace("/", "."),
                    )
                )
            tests.append((re.compile(rf"(?<![\w./])(tests/)?{re.escape(x[6:])}(?!\w)"), rf"\g<1>{y[6:]}"))
        for base in (self.root, *(self.root / d for d in CODE_DIRS)):
            for path in base.glob("*") if base == self.root else base.rglob("*"):
                if path.is_file() and path.suffix in TEXT_SUFFIXES and path.stat().st_size < 2_000_000:
                    try:
                        text = path.read_text(encoding="utf-8")
                    except UnicodeDecodeError:
                        continue
                    if (new := self.apply_text(text, tests)) != text:
                        path.write_text(new, encoding="utf-8")
        for d in sorted((self.root / "tests").rglob("*"), key=lambda q: -len(q.parts)):
            if d.is_dir() and not any(d.iterdir()):
                d.rmdir()
        patched(self.root, self.plan)


def patched(root: Path, plan) -> None:
    """The plan's replacements of text, and files written or removed."""
    for rel in getattr(plan, "DELETE", []):
        q = root / rel
        if q.is_dir():
            shutil.rmtree(q)
        elif q.exists():
            q.unlink()
    for rel, text in getattr(plan, "WRITE", {}).items():
        (root / rel).parent.mkdir(parents=True, exist_ok=True)
        (root / rel).write_text(text, encoding="utf-8")
    for rel, pairs in getattr(plan, "PATCH", {}).items():
        for path in sorted(root.glob(rel)) or [root / rel]:
            if not path.exists():
                say("PATCH: no file", rel)
                continue
            text = path.read_text(encoding="utf-8")
            for old, new in pairs:
                if isinstance(old, re.Pattern):
                    text, n = old.subn(new, text)
                else:
                    n = text.count(old)
                    text = text.replace(old, new)
                if not n and "*" not in rel:
                    say(f"PATCH does not fit: {rel}: {getattr(old, 'pattern', old)[:90]!r}")
            path.write_text(text, encoding="utf-8")


def check(root: Path) -> None:
    """Cycles of the new module graph, and names that are imported but not there."""
    src = root / "src" / PKG
    mods = {}
    for q in src.rglob("*.py"):
        mods[".".join((PKG, *q.relative_to(src).with_suffix("").parts)).removesuffix(".__init__")] = q
    graph: dict[str, set[str]] = {}
    have: dict[str, set[str]] = {}
    for m, q in mods.items():
        tree = ast.parse(q.read_text(encoding="utf-8"))
        have[m] = bound_in(tree.body)
    for m, q in mods.items():
        needs = set()
        for n in ast.walk(ast.parse(q.read_text(encoding="utf-8"))):
            if isinstance(n, ast.ImportFrom) and n.module and n.module.split(".")[0] == PKG:
                for a in n.names:
                    full = f"{n.module}.{a.name}"
                    if full in mods:
                        needs.add(full)
                    else:
                        needs.add(n.module)
                        if n.module not in mods:
                            say(f"MISSING {m}:{n.lineno}: {n.module}")
                        elif a.name not in have[n.module] and "__getattr__" not in have[n.module]:
                            say(f"MISSING {m}:{n.lineno}: {a.name} in {n.module}")
        if m not in (PKG,):
            graph[m] = needs - {m}
    wings = getattr(check, "wings", ())
    for m, needs in graph.items():
        top = m.split(".")[1]
        for n in sorted(needs):
            there = n.split(".")[1] if "." in n else ""
            if there in wings and there != top and not (top == "studio" and there == "live"):
                say(f"WING {m} -> {n}")
    for m in mods:
        if mods[m].name == "__init__.py":
            block = next((x for x in ast.parse(mods[m].read_text()).body if is_type_checking(x)), None)
            for name in {
                a.name
                for x in (block.body if block else [])
                if isinstance(x, ast.ImportFrom) and x.module != m
                for a in x.names
            }:
                if f"{m}.{name}" in mods:
                    say(f"SHADOW {m} shows the name {name}, and has a module of that name")
    # strongly connected components
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    on: set[str] = set()
    sys.setrecursionlimit(10000)

    def strong(v):
        index[v] = low[v] = len(index)
        stack.append(v)
        on.add(v)
        for w in graph.get(v, ()):
            if w not in index:
                strong(w)
                low[v] = min(low[v], low[w])
            elif w in on:
                low[v] = min(low[v], index[w])
        if low[v] == index[v]:
            comp = []
            while True:
                w = stack.pop()
                on.discard(w)
                comp.append(w)
                if w == v:
                    break
            if len(comp) > 1:
                say("CYCLE", sorted(comp))
                for a in sorted(comp):
                    say("   ", a, "->", sorted(graph[a] & set(comp)))

    for v in list(graph):
        if v not in index:
            strong(v)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("root", type=Path)
    parser.add_argument("--plan", type=Path, default=Path(__file__).parent / "plan.py")
    options = parser.parse_args()
    spec = importlib.util.spec_from_file_location("plan", options.plan)
    plan = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(options.plan.parent))
    spec.loader.exec_module(plan)
    split(options.root, plan)
    Regroup(options.root, plan).run()
    ruff = Path(sys.executable).with_name("ruff")
    for words in (["check", "-q", "--fix", "--select", "I,F401"], ["format", "-q"]):
        subprocess.run(
            [ruff, *words, "src", "tests", "benchmarks", "examples", "docs", "tools"], cwd=options.root, check=False
        )
    check.wings = plan.WINGS
    check(options.root)


if __name__ == "__main__":
    main()
