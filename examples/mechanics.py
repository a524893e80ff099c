"""Draws the figures of docs/method.md: `python examples/mechanics.py [FOLDER]`, and prints its table of limits.

Every figure checks the mechanics against something that it does not use: elliptic integrals, published values, Euler's
load. The functions that compute are apart from those that draw.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import brentq
from scipy.special import ellipeinc, ellipj, ellipk, ellipkinc

from onebend.beam.continuation import equilibrium
from onebend.beam.loads import push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.beam.statics import Equilibrium
from onebend.beam.stiffness import Profile, Steps, Uniform
from onebend.records import Array
from onebend.report.style import BLUE, FAINT, GREEN, INK, MUTED, ORANGE, PINK, blank, png_of, styled

LENGTH, STIFFNESS = 0.3, 0.05  # m, N m; every figure is drawn in units of L and EI, so neither matters
UNIFORM = Beam(LENGTH, Uniform(STIFFNESS))
UNIT_FORCE = STIFFNESS / LENGTH  # EI / L^2, N
EULER = 0.25 * np.pi**2  # Euler's load of a cantilever in EI / L^2
ALONG = np.linspace(0.0, 1.0, 121)
DEAD_LOADS = {  # q L^3 / EI: published tip (x, y) / L of a cantilever under a uniform dead load
    1.0: (0.9912, 0.1235),
    5.0: (0.8467, 0.4959),
    9.0: (0.6890, 0.6731),
    15.0: (0.5296, 0.7860),
    25.0: (0.3862, 0.8559),
}


def elastica(load: float, direction: float, s: Array) -> Array:
    """(S, 2) positions / L of Euler's elastica: a uniform cantilever under a dead tip force, by elliptic functions.

    `load` = P L^2 / EI, `direction` of the force in (0, pi). With chi = alpha - direction + pi the balance of moments
    is a pendulum's equation, chi'' = -load sin(chi), at rest at the tip: sin(chi / 2) = p sn(K - omega (1 - s)).
    """
    omega, half = np.sqrt(load), np.sin(0.5 * (np.pi - direction))

    def excess(p: float) -> float:
        return float(ellipk(p**2) - ellipkinc(np.arcsin(min(half / p, 1.0)), p**2) - omega)

    p = float(brentq(excess, half * (1.0 + 1e-15), 1.0 - 1e-15, xtol=1e-16, rtol=1e-15))
    u = ellipk(p**2) - omega * (1.0 - np.concatenate([[0.0], s]))
    _, cn, _, amplitude = ellipj(u, p**2)
    second = ellipeinc(amplitude, p**2)
    x = (2.0 * (second - second[0]) - (u - u[0]))[1:] / omega
    y = 2.0 * p * (cn[0] - cn)[1:] / omega
    turn = direction - np.pi
    return np.stack([x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)], axis=-1)


def under_tip_force(loads: Array, direction: float) -> Equilibrium:
    """Equilibria under dead tip forces of the given P L^2 / EI."""
    force = UNIT_FORCE * np.multiply.outer(loads, [np.cos(direction), np.sin(direction)])
    return equilibrium(UNIFORM, push(force))


def elastica_error(loads: Array, direction: float) -> Array:
    """(T,) largest distance / L between our shapes and the elastica along the whole beam."""
    ours = under_tip_force(loads, direction).xy(ALONG) / LENGTH
    exact = np.stack([elastica(float(load), direction, ALONG) for load in loads])
    return np.asarray(np.max(np.linalg.norm(ours - exact, axis=-1), axis=-1))


@dataclass(frozen=True)
class Hidden(Steps):
    """Steps that do not say where they jump, so that no panel ends there."""

    @property
    def jumps(self) -> tuple[float, ...]:
        return ()


@dataclass(frozen=True)
class Bump:
    """A smooth stiffness with a soft place in the middle: k falls to a third there."""

    def __call__(self, s: Array | float) -> Array:
        return np.asarray(STIFFNESS / (1.0 + 2.0 * np.exp(-(((np.asarray(s) - 0.5) / 0.2) ** 2))))

    @property
    def jumps(self) -> tuple[float, ...]:
        return ()

    def as_dict(self) -> dict[str, object]:
        raise NotImplementedError("this profile is only drawn")


STEP = Steps((0.0, 0.37, 1.0), (2.0 * STIFFNESS, STIFFNESS))


def convergence(profile: Profile, orders: Array, reference: Profile) -> tuple[Array, Array]:
    """Nodes in all and error of the tip / L, under P L^2 / EI = 3 across, for each order of the panels."""
    loads = push([0.0, 3.0 * UNIT_FORCE])
    exact = equilibrium(Beam(LENGTH, reference), loads, resolution=Resolution(48, 0.25)).xy(np.ones(1))
    found = [equilibrium(Beam(LENGTH, profile), loads, resolution=Resolution(int(order))) for order in orders]
    errors = [float(np.linalg.norm(one.xy(np.ones(1)) - exact)) / LENGTH for one in found]
    return np.array([one.q.shape[-1] for one in found]), np.array(errors)


def compressed(shares: Array, slant: float) -> Equilibrium:
    """A column under `shares` of Euler's load along it, and `slant` times as much across."""
    axial = EULER * UNIT_FORCE * shares
    return equilibrium(UNIFORM, push(np.stack([-axial, slant * axial], axis=-1)))


def left_out(slenderness: float, *, poisson: float = 0.5, load: float = 5.0) -> tuple[float, float, float]:
    """What an unshearable, inextensible beam leaves out, for a rectangle of L / h = `slenderness`, as shares.

    Shear: P L / (kappa G A) of a small deflection P L^3 / (3 EI), kappa = 5/6. Stretch: the largest strain, P / EA, at
    `load` = P L^2 / EI. Strain of the outermost fibre where the beam is bent into half a circle, (h / 2) (pi / L).
    """
    thin = 1.0 / slenderness**2
    return 0.6 * (1.0 + poisson) * thin, load * thin / 12.0, 0.5 * np.pi / slenderness


def leaves_the_plane(width_over_thickness: float, *, poisson: float = 0.5) -> float:
    """P L^2 / EI at which a small tip force across makes a strip tip over sideways (Prandtl): 4.013 sqrt(EI' GJ) L^2.

    EI is the stiffness in the plane, EI' the one out of it, GJ Saint-Venant's torsion of the rectangle.
    """
    b = width_over_thickness
    odd = np.arange(1, 40, 2)
    torsion = (1.0 - 192.0 / np.pi**5 * b * np.sum(np.tanh(0.5 * np.pi * odd / b) / odd**5)) / 3.0
    return float(4.013 * np.sqrt(b**2 * 12.0 * torsion * b**2 / (2.0 * (1.0 + poisson))))


def limits() -> str:
    """The table of docs/method.md, in Markdown."""
    head = ["| L / h | shear | stretch | outer strain |", "| --- | --- | --- | --- |"]
    shares = {slenderness: left_out(slenderness) for slenderness in (5, 10, 20, 50)}
    return "\n".join(
        [*head, *(f"| {n} | {' | '.join(f'{100.0 * v:.2f} %' for v in row)} |" for n, row in shares.items())]
    )


@styled
def draw_elastica() -> Figure:
    """Shapes under a growing tip force with points of the elastica, and the distance between them."""
    figure, (shapes, errors) = blank(3.2, 1, 2)
    loads, points = np.array([0.5, 1.0, 2.0, 4.0, 8.0]), np.linspace(0.1, 1.0, 10)
    lines = under_tip_force(loads, 0.5 * np.pi).xy(ALONG) / LENGTH
    for load, line, shade in zip(loads, lines, np.linspace(0.35, 1.0, len(loads)), strict=True):
        exact = elastica(float(load), 0.5 * np.pi, points)
        shapes.plot(*line.T, color=BLUE, alpha=shade)
        shapes.plot(*exact.T, "o", color=ORANGE, markersize=3.4, markeredgewidth=0.0)
        shapes.annotate(f"{load:g}", line[-1], (4.0, 3.0), textcoords="offset points", fontsize=8.5, color=MUTED)
    _plane(shapes, "Pushed across: $PL^2/EI$")
    many = np.geomspace(0.1, 10.0, 25)
    for degrees, colour, mark in ((90.0, BLUE, "o"), (135.0, ORANGE, "s"), (175.0, GREEN, "^")):
        away = np.maximum(elastica_error(many, np.deg2rad(degrees)), 1e-17)
        errors.loglog(many, away, mark, color=colour, markersize=4, label=f"{degrees:.0f}° from the beam")
    errors.set_ylim(1e-17, 1e-9)
    errors.set(title="Distance to the elastica", xlabel="$PL^2/EI$", ylabel="largest along the beam / L")
    errors.legend(loc="upper left")
    return figure


@styled
def draw_convergence() -> Figure:
    """Error against nodes: spectral, unless a jump lies inside a panel."""
    figure, (axes,) = blank(3.2)
    orders = np.concatenate([np.arange(2, 25), np.arange(26, 66, 3)])
    cases = (
        ("smooth k(s)", Bump(), Bump(), BLUE, "o"),
        ("k(s) with a step, a panel ends there", STEP, STEP, GREEN, "^"),
        ("the same step inside a panel", Hidden(STEP.edges, STEP.values), STEP, ORANGE, "s"),
    )
    for label, profile, reference, colour, mark in cases:
        nodes, error = convergence(profile, orders, reference)
        axes.loglog(nodes, np.maximum(error, 1e-17), mark + "-", color=colour, markersize=3.6, lw=1.0, label=label)
    guide = np.array([4.0, 64.0])
    axes.loglog(guide, 0.2 / guide, "--", color=MUTED, lw=1.0)
    axes.annotate("1/N", (guide[-1], 0.2 / guide[-1]), (4, -3), textcoords="offset points", color=MUTED)
    axes.set_xticks([4, 8, 16, 32, 64], ["4", "8", "16", "32", "64"])
    axes.minorticks_off()
    axes.set(title="How fast the error falls", xlabel="Gauss nodes, in all", ylabel="error of the tip / L")
    axes.legend(loc="lower left")
    return figure


@styled
def draw_buckling() -> Figure:
    """Deflection of a column against its load, perfect and not, with Euler's load and the exact branch."""
    figure, (axes,) = blank(3.4)
    shares = np.concatenate([np.linspace(0.02, 0.9, 23), np.linspace(0.92, 1.1, 37), np.linspace(1.12, 1.6, 25)])
    p = np.sin(0.5 * np.linspace(1e-3, np.deg2rad(130.0), 200))
    root = ellipk(p**2)
    inside = (root / (0.5 * np.pi)) ** 2 <= 1.6
    axes.plot(
        (2.0 * p / root)[inside],
        ((root / (0.5 * np.pi)) ** 2)[inside],
        "--",
        color=INK,
        lw=1.1,
        zorder=5,
        label="elastica",
    )
    for slant, colour in ((1e-4, BLUE), (1e-2, GREEN), (5e-2, ORANGE), (2e-1, PINK)):
        tip = compressed(shares, slant).xy(np.ones(1))[:, 0, 1] / LENGTH
        axes.plot(tip, shares, color=colour, label=f"side force {100.0 * slant:g} % of P")
    perfect = compressed(np.array([1.6]), 0.0)
    lost = float(perfect.buckled_at[0]) * 1.6
    axes.plot([0.0, 0.0], [lost, 1.6], ":", color=INK, lw=1.4)
    axes.plot(
        0.0,
        lost,
        "o",
        color=INK,
        markersize=5,
        clip_on=False,
        zorder=4,
        label=f"straight: stability lost at {lost:.6f}",
    )
    axes.axhline(1.0, color=MUTED, lw=0.8)
    axes.annotate("$P = \\pi^2 EI / 4L^2$", (0.87, 1.0), (0, -12), textcoords="offset points", ha="right", color=MUTED)
    axes.set(
        title="Buckling", xlabel="tip to the side / L", ylabel="P / Euler's load", xlim=(-0.01, 0.88), ylim=(0, 1.65)
    )
    axes.legend(loc="lower right")
    return figure


@styled
def draw_closed_forms() -> Figure:
    """Rolled up by a tip moment, and bent by a uniform dead load with the published tips."""
    figure, (rolled, loaded) = blank(3.2, 1, 2)
    turns = np.array([0.25, 0.5, 0.75, 1.0])
    circles = equilibrium(UNIFORM, twist(2.0 * np.pi * STIFFNESS * turns)).xy(ALONG) / LENGTH
    for turn, line in zip(turns, circles, strict=True):
        rolled.plot(*line.T, color=BLUE, alpha=0.3 + 0.7 * turn)
    _plane(rolled, "A tip moment up to $2\\pi EI/L$")
    heavy = Beam(LENGTH, Uniform(STIFFNESS), mass_per_length=Uniform(1.0))
    q = np.array(list(DEAD_LOADS))
    lines = equilibrium(heavy, weight(np.outer(q * UNIT_FORCE / LENGTH, [0.0, 1.0]))).xy(ALONG) / LENGTH
    for load, line in zip(q, lines, strict=True):
        loaded.plot(*line.T, color=BLUE)
        loaded.plot(*DEAD_LOADS[float(load)], "o", color=ORANGE, markersize=5)
        loaded.annotate(f"{load:g}", line[-1], (5, 3), textcoords="offset points", fontsize=8.5, color=MUTED)
    _plane(loaded, "A uniform dead load: $qL^3/EI$")
    return figure


def _plane(axes: Axes, title: str) -> None:
    """Axes of the beam's plane, with the clamp."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.plot([0.0, 0.0], [-0.05, 0.05], color=INK, lw=4.0, solid_capstyle="butt")
    axes.grid(color=FAINT)
    axes.set(title=title, xlabel="x / L", ylabel="y / L")


def main(out: Path) -> list[Path]:
    """Write the figures into a folder; returns their paths."""
    out.mkdir(parents=True, exist_ok=True)
    drawings = {
        "elastica": draw_elastica,
        "convergence": draw_convergence,
        "buckling": draw_buckling,
        "closed-forms": draw_closed_forms,
    }
    written = []
    for name, draw in drawings.items():
        written.append(out / f"mechanics-{name}.png")
        written[-1].write_bytes(png_of(draw()))
    return written


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1] / "docs" / "images"
    for path in main(folder):
        print(f"{path}: {path.stat().st_size / 1000:.0f} kB")
    print(limits())
    print("tips over sideways at P L^2 / EI =", {b: round(leaves_the_plane(b), 3) for b in (0.1, 0.25, 0.5)})
