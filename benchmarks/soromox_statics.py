"""One equilibrium at equal error: the public call beside soromox's chain of constant curvatures, in pairs.

    python -m venv /tmp/soromox && /tmp/soromox/bin/pip install soromox threadpoolctl
    PYTHONPATH=src:. /tmp/soromox/bin/python -m benchmarks.soromox_statics

soromox (JAX) has no static solver. Newton's method is put on its model here, compiled: `K q = J(q)^T F` with its
stiffness, its forward kinematics of the tip and JAX's derivatives of it. Bending alone is active. The force grows in
four steps, without which Newton's method does not come from rest. JAX compiles for some seconds first, which are not
counted. It is not among the project's dependencies: this runs in an environment of its own.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.stiffness import Gaussians, equidistant
from onebend.records import Array

BEAM = Beam(0.15, Gaussians(equidistant(3), 0.5, (0.02, 0.03, 0.015)))  # that of `benchmarks.mechanics`
FORCE = (0.12, 0.3)
SEGMENTS = (5, 10, 20)
STEPS, ITERATIONS = 4, 4
PAIRS, BATCHES = 25, 3


def chain(segments: int) -> Callable[[Array], Array]:
    """Forces (T, 2) N to (T, 2) m of the tip: Newton's method, compiled."""
    jax: Any = import_module("jax")
    jax.config.update("jax_enable_x64", True)
    jnp: Any = import_module("jax.numpy")
    systems: Any = import_module("soromox.systems.pcs")
    components: Any = import_module("soromox.systems.components")
    structures: Any = import_module("soromox.systems.pcs.structures")
    h = BEAM.length / segments
    bending = BEAM.length * np.asarray(BEAM.stiffness((np.arange(segments) + 0.5) / segments))  # E I, N m^2
    links = [
        components.LinkSpec.circular(
            length=h,
            density=1000.0,
            radius=0.005,
            reference_strain=[0.0, 1.0, 0.0],
            stiffness=np.diag([h * one, 1.0, 1.0]),
            damping=np.zeros((3, 3)),
        )
        for one in bending
    ]
    selector = np.tile([True, False, False], segments)
    structure = structures.PlanarPCSStructure(strain_selector=jnp.asarray(selector))
    robot = systems.PlanarPCS.from_links(links, structure=structure, backend="jax", base_pose=jnp.zeros(3))
    stiff = robot.stiffness_matrix()

    def tip(q: Any) -> Any:
        return robot.forward_kinematics(q, jnp.asarray(BEAM.length))[1:3]

    def balance(q: Any, force: Any) -> Any:
        return stiff @ q - jax.jacfwd(tip)(q).T @ force

    def solve(force: Any) -> Any:
        def step(i: Any, q: Any) -> Any:
            share = (i // ITERATIONS + 1) / STEPS
            return q - jnp.linalg.solve(jax.jacfwd(balance)(q, share * force), balance(q, share * force))

        return tip(jax.lax.fori_loop(0, STEPS * ITERATIONS, step, jnp.zeros(segments)))

    compiled = jax.jit(jax.vmap(solve))
    return lambda forces: np.asarray(compiled(jnp.asarray(forces)))


def pairs(count: int, ours: Callable[[], object], theirs: Callable[[], object]) -> Array:
    """(count, 2) s on the clock, one after the other."""
    out = np.empty((count, 2))
    for row in out:
        for i, work in enumerate((ours, theirs)):
            begin = time.perf_counter()
            work()
            row[i] = time.perf_counter() - begin
    return out


def main() -> None:
    if find_spec("soromox") is None:
        print("soromox is not installed here; see the first lines of benchmarks/soromox_statics.py.")
        return
    turn = 1.2 + 0.3 * np.sin(np.linspace(0.0, 6.0, 1000))
    many = np.linspace(0.05, 0.35, 1000)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    one = np.array([FORCE])
    exact, exact_many = BEAM.equilibrium(FORCE).xy(1.0), BEAM.equilibrium(many).xy(1.0)
    print("| soromox, segments | error | one force | ours | ratio | 1000 forces | ours | ratio |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for segments in SEGMENTS:
        run = chain(segments)
        off = float(np.linalg.norm(run(one)[0] - exact)) / BEAM.length
        off = max(off, float(np.max(np.linalg.norm(run(many) - exact_many, axis=1))) / BEAM.length)
        single = pairs(PAIRS, lambda: BEAM.equilibrium(FORCE), lambda run=run: run(one))  # type: ignore[misc]
        batch = pairs(BATCHES, lambda: BEAM.equilibrium(many), lambda run=run: run(many))  # type: ignore[misc]
        print(f"| {segments} | {off:.1e} L |{said(single)}{said(batch)}", flush=True)


def said(seconds: Array) -> str:
    """Three cells: theirs, ours, and how many times ours is faster (medians)."""
    ours, theirs = 1e3 * np.median(seconds, axis=0)
    ratio = np.median(seconds[:, 1] / seconds[:, 0])
    return f" {theirs:.2f} ms | {ours:.2f} ms | {ratio:.2g} |"


if __name__ == "__main__":
    main()
