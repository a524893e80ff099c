"""The beam's statics: accuracy against exact solutions, speed against a general solver, cost of all derivatives."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import solve_bvp
from scipy.linalg import solveh_banded

from onebend.beam.continuation import equilibrium, follow, refine
from onebend.beam.loads import push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem
from onebend.beam.sensitivity import of_clamp_angle, of_force, of_mass, of_rest_curvature, of_stiffness, respond
from onebend.beam.statics import Equilibrium, tangent
from onebend.beam.stiffness import Gaussians, LogSpline, Table, Uniform, equidistant, gaussian_basis, power_basis
from onebend.records import Array
from tests.beam.exact import elastica_tip

FRAMES = 500
BEAM = Beam(0.15, Gaussians(equidistant(3), 0.5, (0.02, 0.03, 0.015)))
TIP = np.array([1.0])
DISTRIBUTED = {
    1: (0.9912, 0.1235),
    5: (0.8467, 0.4959),
    9: (0.6890, 0.6731),
    15: (0.5296, 0.7860),
    25: (0.3862, 0.8559),
}
ABAQUS = [  # source: the tests of the VirtualBow project
    ((10, 10), 0.0, (-200.0, 200.0), (0.840615, 0.488158)),
    ((10, 5), 0.0, (-100.0, 100.0), (0.821444, 0.468253)),
    ((10, 10), np.pi / 4, (-200.0, 200.0), (0.574706, 0.701739)),
    ((10, 5), np.pi / 4, (-100.0, 100.0), (0.576773, 0.659438)),
]


@dataclass(frozen=True)
class Row:
    """One measured figure beside what is asked of it."""

    name: str
    value: float
    unit: str
    target: str


def best_of(work: Callable[[], object], times: int = 5) -> float:
    """Least CPU seconds of several runs: other work on the machine can only add."""
    work()
    seconds = []
    for _ in range(times):
        begin = time.process_time()
        work()
        seconds.append(time.process_time() - begin)
    return min(seconds)


def accuracy() -> list[Row]:
    """Worst errors against exact and published solutions."""
    unit = Beam(1.0, Uniform(1.0))
    worst = 0.0
    for load in (0.2, 1.0, 2.0, 5.0, 10.0):
        for degrees in (10, 45, 90, 135, 170, 179, -60, -150):
            a = np.deg2rad(degrees)
            tip = unit.equilibrium((load * np.cos(a), load * np.sin(a))).xy(1.0)
            worst = max(worst, float(np.linalg.norm(tip - elastica_tip(load, a)[:2])))
    heavy = Beam(1.0, Uniform(1.0), mass_per_length=Uniform(1.0))
    sag = max(
        float(np.max(np.abs(equilibrium(heavy, weight((0.0, float(q)))).xy(TIP)[0, 0] - tip)))
        for q, tip in DISTRIBUTED.items()
    )
    s = np.linspace(0.0, 1.0, 201)
    published = 0.0
    for (first, last), rest, force, printed in ABAQUS:
        stiffness = Table(tuple(s), tuple(210e9 * (1e-3 * (first + (last - first) * s)) ** 4 / 12.0))
        found = Beam(1.0, stiffness, rest_curvature=Uniform(rest)).equilibrium(force).xy(1.0)
        published = max(published, float(np.linalg.norm(found - printed)))
    circle = float(np.max(np.abs(equilibrium(unit, twist(2.0 * np.pi)).xy(TIP))))
    return [
        Row("elastica, P L^2/EI 0.2 to 10, eight directions", worst, "L", "<= 1e-10"),
        Row("uniform dead load, five printed tips (4 digits)", sag, "L", "<= 6e-5"),
        Row("Abaqus, four cases", 1e3 * published, "mm", "<= 0.1"),
        Row("roll-up into a circle: the tip meets the clamp", circle, "L", "<= 1e-10"),
    ]


def pushes(count: int) -> Array:
    """Forces that bend the beam's tip by up to about 75 degrees."""
    phase = np.linspace(0.0, np.pi, count + 2)[1:-1]
    size, turn = 0.35 * np.sin(phase) ** 2, 1.2 + 0.5 * np.sin(2.0 * phase)
    return np.stack([size * np.cos(turn), size * np.sin(turn)], axis=1)


def large_pushes(count: int) -> Array:
    """The same, larger: the tip turns by up to 90 degrees."""
    return 13.7 * pushes(count)


def by_collocation_library(force: Array, tolerance: float) -> Array:
    """The same equilibrium by `scipy.integrate.solve_bvp`: alpha, moment and position as a first-order system."""
    length = BEAM.length

    def slopes(s: Array, y: Array) -> Array:
        alpha, moment = y[0], y[1]
        lever = -length * (np.cos(alpha) * force[1] - np.sin(alpha) * force[0])
        return np.vstack([moment / BEAM.stiffness(s), lever, length * np.cos(alpha), length * np.sin(alpha)])

    def ends(a: Array, b: Array) -> Array:
        return np.array([a[0], b[1], a[2], a[3]])

    s = np.linspace(0.0, 1.0, 11)
    start = np.vstack([0.0 * s, 0.0 * s, length * s, 0.0 * s])
    found = solve_bvp(slopes, ends, s, start, tol=tolerance, max_nodes=100000)
    return np.asarray(found.y[2:, -1])


def speed() -> list[Row]:
    """One equilibrium in a batch against one by the general solver, both at 1e-6 L; and all derivatives."""
    force = pushes(FRAMES)
    exact = equilibrium(BEAM, push(force), resolution=Resolution(24)).xy(TIP)[:, 0]
    limit = 1e-6 * BEAM.length
    order = next(
        n
        for n in range(4, 24)
        if np.max(np.abs(follow(make_problem(BEAM, push(force), Resolution(n))).xy(TIP)[:, 0] - exact)) <= limit
    )
    ours = best_of(lambda: follow(make_problem(BEAM, push(force), Resolution(order)))) / FRAMES
    some = range(25, FRAMES, 50)
    tolerance = next(
        t
        for t in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
        if max(float(np.max(np.abs(by_collocation_library(force[i], t) - exact[i]))) for i in some) <= limit
    )
    theirs = best_of(lambda: [by_collocation_library(force[i], tolerance) for i in some], 3) / len(some)
    return [
        Row(f"one equilibrium, batch of {FRAMES}, {order} nodes, cold, error <= 1e-6 L", 1e6 * ours, "us", ""),
        Row(f"the same by solve_bvp (tol {tolerance:g})", 1e6 * theirs, "us", ""),
        Row("times faster", theirs / ours, "", ">= 300"),
        Row(
            "floor of one Newton step: 2 Q^3 / 3 + 3 Q^2 flops at 4 Gflop/s",
            (2 * order**3 / 3 + 3 * order**2) / 4e3,
            "us",
            "",
        ),
        *public_calls(force[FRAMES // 4]),
        *derivatives(force),
    ]


def public_calls(force: Array) -> list[Row]:
    """`Beam.equilibrium` as users call it, grid and checks included, beside others at their errors; ratios in pairs."""
    many, exact = pushes(1000), equilibrium(BEAM, push(force), resolution=Resolution(32)).xy(TIP)[0, 0]

    def off(tip: Array) -> float:
        return float(np.linalg.norm(tip - exact)) / BEAM.length

    def mine() -> Array:
        return BEAM.equilibrium(force).xy(1.0)

    spline = wavy_spline()
    fine = equilibrium(spline, push(force), resolution=Resolution(16, 1.0, at_knots=True)).xy(TIP)[0, 0]
    tolerance = next(t for t in (1e-7, 1e-8, 1e-9, 1e-10) if off(by_collocation_library(force, t)) <= 1e-8)
    rows = [
        Row("Beam.equilibrium, one force", 1e3 * best_of(lambda: BEAM.equilibrium(force), 50), "ms", "<= 0.8"),
        Row("its error at the tip", off(mine()), "L", "<= 1e-8"),
        Row("Beam.equilibrium, 1000 forces", 1e3 * best_of(lambda: BEAM.equilibrium(many)), "ms", "<= 12"),
        Row("one force, k(s) a spline of 45 knots", 1e3 * best_of(lambda: spline.equilibrium(force), 20), "ms", ""),
        Row(
            "its error at the tip",
            float(np.linalg.norm(spline.equilibrium(force).xy(1.0) - fine)) / 0.15,
            "L",
            "<= 1e-8",
        ),
        Row(
            f"one force with its tip, times faster than solve_bvp at 1e-8 L (tol {tolerance:g})",
            in_pairs(mine, lambda: by_collocation_library(force, tolerance)),
            "",
            "",
        ),
    ]
    for links in (20, 200, 4500):
        away, ratio = off(by_hinges(force, links)), in_pairs(mine, lambda n=links: by_hinges(force, n))  # type: ignore[misc]
        rows.append(Row(f"the same, times faster than a chain of {links} hinges at {away:.0e} L", ratio, "", ""))
    return rows


def large_bending() -> list[Row]:
    """`Beam.equilibrium` where tips turn by up to 90 degrees, beside the bare linear algebra of it."""
    many = large_pushes(1000)
    shape = BEAM.equilibrium(many)
    turned = np.abs(shape.angle(1.0))
    one = many[int(np.argmax(turned))]
    fine = equilibrium(BEAM, push(one), resolution=Resolution(32, 0.25)).xy(TIP)[0, 0]
    q = shape.solved.q
    matrices, right, angles = (
        tangent(shape.solved.problem, q)[:, ::2, ::2].copy(),
        q[:, ::2, None].copy(),
        shape.solved.alpha,
    )

    def bare() -> None:
        for _ in range(3):
            np.linalg.solve(matrices, right)
            np.cos(angles), np.sin(angles)

    batch, single = best_of(lambda: BEAM.equilibrium(many), 9), best_of(lambda: BEAM.equilibrium(one), 50)
    off = float(np.linalg.norm(BEAM.equilibrium(one).xy(1.0) - fine)) / BEAM.length
    return [
        Row("largest turn of the tip, of 1000 forces", float(np.rad2deg(np.max(turned))), "degrees", ""),
        Row("Beam.equilibrium, these 1000 forces", 1e3 * batch, "ms", "<= 12"),
        Row("floor: three times cos, sin and a solve of 16 unknowns each, bare", 1e3 * best_of(bare, 9), "ms", ""),
        Row("Beam.equilibrium, the one of them that turns the tip most", 1e3 * single, "ms", "<= 0.6"),
        Row("its error at the tip", off, "L", "<= 1e-8"),
    ]


def in_pairs(ours: Callable[[], object], theirs: Callable[[], object], count: int = 15) -> float:
    """Median of CPU seconds of theirs over ours, one after the other."""
    return float(np.median([best_of(theirs, 1) / best_of(ours, 1) for _ in range(count)]))


def wavy_spline() -> Beam:
    """log k(s) a cubic spline with 45 knots inside, its coefficients drawn."""
    knots = (0.0, 0.0, 0.0, *np.linspace(0.0, 1.0, 47).tolist(), 1.0, 1.0, 1.0)
    drawn = np.log(0.02) + 0.2 * np.random.default_rng(0).standard_normal(49)
    return Beam(0.15, LogSpline(knots, tuple(drawn.tolist())))


def by_hinges(force: Array, links: int) -> Array:
    """(2,) m of the tip of rigid links with springs `E I / h` (twice that at the clamp), by Newton's method, banded."""
    h = BEAM.length / links
    spring = BEAM.length * BEAM.stiffness(np.arange(links) / links) / h
    spring[0] *= 2.0
    band = np.zeros((2, links))
    band[0, 1:], ahead = -spring[1:], np.append(spring[1:], 0.0)
    angle = np.zeros(links)
    for _ in range(12):
        cos, sin = np.cos(angle), np.sin(angle)
        turns = spring * np.diff(angle, prepend=0.0)
        unbalanced = turns - np.append(turns[1:], 0.0) - h * (force[1] * cos - force[0] * sin)
        band[1] = spring + ahead + h * (force[1] * sin + force[0] * cos)
        step = solveh_banded(band, unbalanced, check_finite=False)
        angle -= step
        if float(np.abs(step).max()) < 1e-7:
            break
    return h * np.array([np.sum(np.cos(angle)), np.sum(np.sin(angle))])


def derivatives(force: Array) -> list[Row]:
    """Cost of 21 derivatives of three tags together, over the cost of the solve."""
    loads = push(force) + weight((0.0, -1.0))
    beam = Beam(BEAM.length, BEAM.stiffness, mass_per_length=Uniform(0.5))
    solved = follow(make_problem(beam, loads, Resolution(12)))
    nodes, s = solved.problem.grid.nodes, np.array([1.0 / 3.0, 2.0 / 3.0, 1.0])
    functions = gaussian_basis(nodes, equidistant(12), 0.1)

    def everything() -> Array:
        change = (
            of_stiffness(solved, functions)
            + of_rest_curvature(solved.problem, power_basis(nodes, 3))
            + of_clamp_angle(solved.problem)
            + of_mass(solved.problem, power_basis(nodes, 3), np.array([[0.0, -1.0]]))
            + of_force(solved.problem, np.array(1.0))
        )
        return respond(solved, change).xy(s)

    solve = best_of(lambda: follow(make_problem(beam, loads, Resolution(12))))
    return [Row("all 21 derivatives of three tags, over the cold solve", best_of(everything) / solve, "", "<= 2")]


def stretching(force: Array) -> list[Row]:
    """What stretch and shear cost, over the same beam without: cold, warm, and all derivatives of three tags."""
    loads, s = push(force) + weight((0.0, -1.0)), np.array([1.0 / 3.0, 2.0 / 3.0, 1.0])
    thin = replace(BEAM, mass_per_length=Uniform(0.5))
    beams = (thin, replace(thin, thickness=0.08 * thin.length))
    problems = [make_problem(beam, loads, Resolution(12)) for beam in beams]
    solved = [follow(problem) for problem in problems]
    functions = gaussian_basis(problems[0].grid.nodes, equidistant(12), 0.1)

    def all_derivatives(one: Equilibrium) -> Array:
        fresh = replace(one)  # nothing worked out before
        change = of_stiffness(fresh, functions) + of_force(fresh.problem, np.array(1.0))
        change = change + of_clamp_angle(fresh.problem)
        return respond(fresh, change).poses(s)

    work: dict[str, tuple[Callable[[], object], ...]] = {
        "cold": tuple(lambda p=p: follow(p) for p in problems),  # type: ignore[misc]
        "warm": tuple(lambda e=e: refine(e.problem, e.q + 0.003) for e in solved),  # type: ignore[misc]
        "15 derivatives of three tags": tuple(lambda e=e: all_derivatives(e) for e in solved),  # type: ignore[misc]
    }
    out = []
    for name, (without, with_strain) in work.items():
        ratio = min(best_of(with_strain) / best_of(without) for _ in range(3))
        out.append(Row(f"stretch and shear, batch of {FRAMES}, over without: {name}", ratio, "", "<= 1.5"))
    return out


def rows() -> list[Row]:
    """All figures."""
    return accuracy() + speed() + large_bending() + stretching(pushes(FRAMES))


def main() -> None:
    print("| what | measured | asked |\n| --- | --- | --- |")
    for row in rows():
        print(f"| {row.name} | {row.value:.3g} {row.unit} | {row.target} |")


if __name__ == "__main__":
    main()
