"""One equilibrium against a general simulator brought to rest: MuJoCo's chain of hinges, damped until it stands.

The chain is given every advantage that is fair: an implicit integrator, damping near critical for its slowest motion,
the best of several time steps, and a coarse notion of rest (its tip within 1e-4 L of where it ends). The error beside
each row is what remains against the exact tip, so that the rows can be compared.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import mujoco
import numpy as np

from onebend.beam.continuation import follow
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem
from onebend.beam.stiffness import Uniform
from onebend.records import Array

Row = tuple[str, float, str, str]
BEAM = Beam(1.0, Uniform(1.0))
FORCE = np.array([0.0, 2.0])
FRAMES = 500


def ours() -> tuple[float, float]:
    """CPU seconds of one equilibrium in a batch of different forces, and the tip's error at FORCE [L]."""
    forces = FORCE * np.linspace(0.5, 1.0, FRAMES)[:, None]
    exact = BEAM.equilibrium(FORCE).xy(1.0)
    best = np.inf
    for _ in range(5):
        begin = time.process_time()
        solved = follow(make_problem(BEAM, push(forces), Resolution(6)))
        best = min(best, (time.process_time() - begin) / FRAMES)
    return best, float(np.linalg.norm(solved.xy(np.array([1.0]))[-1, 0] - exact))


def chain_at_rest(links: int, step: float) -> tuple[float, float]:
    """CPU seconds until the tip stays within 1e-4 L of its end, and its error against the exact tip [L]."""
    model = mujoco.MjModel.from_xml_string(_chain(links, step))
    data = mujoco.MjData(model)
    tip = model.site("tip").id
    last = model.body(f"b{links - 1}").id
    path: list[Array] = []
    begin = time.process_time()
    seconds = []
    for _ in range(round(20.0 / step)):
        point = data.site_xpos[tip].copy()
        data.qfrc_applied[:] = 0.0
        mujoco.mj_applyFT(model, data, np.array([0.0, FORCE[1], 0.0]), np.zeros(3), point, last, data.qfrc_applied)
        mujoco.mj_step(model, data)
        path.append(data.site_xpos[tip, :2].copy())
        seconds.append(time.process_time() - begin)
    away = np.linalg.norm(np.array(path) - path[-1], axis=1)
    settled = int(np.flatnonzero(away > 1e-4)[-1]) + 1
    return seconds[min(settled, len(seconds) - 1)], float(np.linalg.norm(path[-1] - BEAM.equilibrium(FORCE).xy(1.0)))


def _chain(links: int, step: float) -> str:
    """Rigid links of equal length; the first hinge bears half a link's bending, as the clamp does."""
    h = 1.0 / links
    opened = ""
    for i in range(links):
        stiffness = links * (2.0 if i == 0 else 1.0)
        place = "0 0 0" if i == 0 else f"{h} 0 0"
        opened += (
            f'<body name="b{i}" pos="{place}"><joint type="hinge" axis="0 0 1" stiffness="{stiffness}" '
            f'damping="{0.5 * stiffness}"/><geom type="capsule" fromto="0 0 0 {h} 0 0" size="0.005" mass="{h}" '
            'contype="0" conaffinity="0"/>'
        )
    return (
        f'<mujoco><option gravity="0 0 0" timestep="{step}" integrator="implicitfast"/><worldbody>'
        f'{opened}<site name="tip" pos="{h} 0 0"/>{"</body>" * links}</worldbody></mujoco>'
    )


def rows() -> Iterator[Row]:
    """Ours, then the chain at several sizes with the quickest of three steps each."""
    cpu, error = ours()
    yield f"ours, one of a batch of {FRAMES}, cold", 1e6 * cpu, "us", ""
    yield "ours: error of the tip", error, "L", ""
    for links in (10, 20, 40):
        tried = [chain_at_rest(links, step) for step in (0.02, 0.01, 0.005)]
        seconds, off = min(tried)
        yield f"MuJoCo, {links} links, brought to rest", 1e6 * seconds, "us", ""
        yield f"MuJoCo, {links} links: error of the tip", off, "L", ""
        yield f"times faster than {links} links, whose error is larger", seconds / cpu, "", ">= 300 at equal error"


def main() -> None:
    """Print the figures as a Markdown table."""
    print("| figure | value | unit | target |\n| --- | --- | --- | --- |")
    for name, value, unit, target in rows():
        print(f"| {name} | {value:.3g} | {unit} | {target} |", flush=True)


if __name__ == "__main__":
    main()
