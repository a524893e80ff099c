"""A slender beam, clamped at s = 0, at rest under a force and its weight. Needs Python alone, no other package.

    >>> x, y, alpha = shape((0.0, 0.1), at_s=1.0, s=[0.5, 1.0])

Frame: origin at the clamp, x along it, y to its left; m, N, rad. A force is positive when it acts on the beam. The
branch of equilibria that grows from rest is followed; where it ends, an error is raised.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence

# --- the beam -------------------------------------------------------------------------------------------------------
LENGTH_M = 1.0
CLAMP_ANGLE_RAD = 0.0
# Tables at equidistant places from the clamp to the tip:
K_N_M: tuple[float, ...] = (1.0, 1.0)  # bending stiffness k = E I / L; linear between the places in 1 / k
Q0_RAD: tuple[float, ...] = (0.0, 0.0)  # curvature at rest, per unit of s
MU_KG_M: tuple[float, ...] = (0.0, 0.0)  # mass per metre
STRETCH_1_N: tuple[float, ...] = (0.0, 0.0)  # 1 / EA
SHEAR_1_N: tuple[float, ...] = (0.0, 0.0)  # 1 / kGA
# --------------------------------------------------------------------------------------------------------------------

EVERY_TWENTIETH = (*(0.05 * i for i in range(20)), 1.0)
STEPS = 200  # of the integration from tip to clamp, fourth order

Row = tuple[float, float, float, float, float, float]  # alpha, M, d alpha, d M (by the tip's angle), x, y from the tip
Pull = tuple[float, float, float, float]  # the force beyond a place [N], and gravity [m/s^2]


def shape(
    force: tuple[float, float],
    at_s: float = 1.0,
    s: Sequence[float] = EVERY_TWENTIETH,
    gravity: tuple[float, float] = (0.0, 0.0),
) -> tuple[list[float], list[float], list[float]]:
    """x [m], y [m] and the tangent's angle [rad] at the places `s`, under a force [N] at `at_s` and gravity [m/s^2].

    Raises:
        ValueError: a place outside [0, 1], or the branch of equilibria that grows from rest ends before the whole load.
    """
    if not all(0.0 <= place <= 1.0 for place in (at_s, *s)):
        raise ValueError("places along the beam are between 0 (clamp) and 1 (tip)")
    part, step, slope = 0.0, 0.25, 0.0  # of the load; change of the tip's angle with it
    turn = CLAMP_ANGLE_RAD + Q0_BEYOND[0]
    rows = _integrate(turn, 0.0, force, at_s, gravity)[1]
    while part < 1.0:
        step = min(step, 1.0 - part)
        try:
            found, bent = _newton(turn + slope * step, part + step, force, at_s, gravity)
            if max(abs(new[0] - old[0]) for new, old in zip(bent, rows, strict=True)) > 0.5:
                raise ArithmeticError  # too far to be sure that it is the same branch
        except ArithmeticError:
            step /= 2
            if step < 1e-4:
                raise ValueError(
                    f"the beam snaps through at {100 * part:.1f} % of this load; give a smaller one"
                ) from None
            continue
        slope = (found - turn) / step
        part, turn, rows, step = part + step, found, bent, 1.5 * step
    return _at(s, *_integrate(turn, 1.0, force, at_s, gravity))


def _newton(
    turn: float, part: float, force: tuple[float, float], at_s: float, gravity: tuple[float, float]
) -> tuple[float, list[Row]]:
    """The tip's angle with which the beam meets the clamp, from a near one, and the states along the beam.

    Only a stable shape will do: by Jacobi's condition, one whose variation by the tip's angle has no zero.
    """
    for _ in range(20):
        rows = _integrate(turn, part, force, at_s, gravity)[1]
        if not min(row[2] for row in rows) > 0.0:
            break
        miss = CLAMP_ANGLE_RAD - rows[-1][0]
        change = miss / rows[-1][2]
        if abs(miss) < 1e-10 or (abs(change) < 1e-14 and abs(miss) < 1e-5):  # as near as a float can tell
            return turn, rows
        if abs(change) > 0.7:
            break
        turn += change
    raise ArithmeticError


def _integrate(
    turn: float, part: float, force: tuple[float, float], at_s: float, gravity: tuple[float, float]
) -> tuple[list[float], list[Row], list[Pull]]:
    """From the tip (no moment there) to the clamp: the places, the state at each, and the loads between."""
    beyond = max(1, math.ceil(STEPS * (1.0 - at_s))) if at_s < 1.0 else 0
    grid = [1.0 - i * (1.0 - at_s) / beyond for i in range(beyond)] if beyond else []
    below = max(1, STEPS - beyond)
    grid += [at_s * (1.0 - i / below) for i in range(below + 1)]
    row: Row = (turn, 0.0, 1.0, 0.0, 0.0, 0.0)
    rows, pulls = [row], []
    for i in range(len(grid) - 1):
        loaded = part if i >= beyond else 0.0
        pull = (loaded * force[0], loaded * force[1], part * gravity[0], part * gravity[1])
        row = _runge_kutta(row, grid[i], grid[i + 1] - grid[i], pull)
        rows.append(row)
        pulls.append(pull)
    return grid, rows, pulls


def _runge_kutta(row: Row, s: float, h: float, pull: Pull) -> Row:
    a = _slope(row, s, pull)
    b = _slope(_moved(row, a, h / 2), s + h / 2, pull)
    c = _slope(_moved(row, b, h / 2), s + h / 2, pull)
    d = _slope(_moved(row, c, h), s + h, pull)
    mean = tuple((p + 2 * q + 2 * r + t) / 6 for p, q, r, t in zip(a, b, c, d, strict=True))
    return _moved(row, mean, h)


def _moved(row: Sequence[float], slope: Sequence[float], h: float) -> Row:
    a, b, c, d, e, f = (value + h * change for value, change in zip(row, slope, strict=True))
    return a, b, c, d, e, f


def _slope(row: Row, s: float, pull: Pull) -> Row:
    """By s: alpha' = q0 + M / k, r' = L (t + T / EA t + V / kGA n), M' = -r' x N, and the same by the tip's angle.

    T and V are the parts of the force N along t and across it, along n.
    """
    alpha, moment, d_alpha, d_moment = row[:4]
    hanging = LENGTH_M * _beyond(MU_KG_M, MU_BEYOND, s) if pull[2] or pull[3] else 0.0  # kg
    nx, ny = pull[0] + hanging * pull[2], pull[1] + hanging * pull[3]
    cos, sin = math.cos(alpha), math.sin(alpha)
    tension, across = cos * nx + sin * ny, cos * ny - sin * nx
    give, stretch, shear = _between(GIVE, s), _between(STRETCH_1_N, s), _between(SHEAR_1_N, s)
    long, wide, more = 1.0 + stretch * tension, shear * across, stretch - shear
    return (
        _between(Q0_RAD, s) + moment * give,
        -LENGTH_M * across * (1.0 + more * tension),
        d_moment * give,
        LENGTH_M * (tension + more * (tension**2 - across**2)) * d_alpha,
        LENGTH_M * (long * cos - wide * sin),
        LENGTH_M * (long * sin + wide * cos),
    )


def _at(
    s: Sequence[float], places: list[float], states: list[Row], pulls: list[Pull]
) -> tuple[list[float], list[float], list[float]]:
    """Cubic between the integration's places."""
    grid, rows, between = places[::-1], states[::-1], pulls[::-1]
    x0, y0 = rows[0][4], rows[0][5]
    out: tuple[list[float], list[float], list[float]] = ([], [], [])
    for place in s:
        i = _index(grid, place)
        h = grid[i + 1] - grid[i]
        u = (place - grid[i]) / h
        low, high = (_slope(rows[j], grid[j], between[i]) for j in (i, i + 1))
        for values, part, begins in zip(out, (4, 5, 0), (x0, y0, 0.0), strict=True):
            values.append(_hermite(u, h, rows[i][part], rows[i + 1][part], low[part], high[part]) - begins)
    return out


def _hermite(u: float, h: float, low: float, high: float, slope_low: float, slope_high: float) -> float:
    v = 1.0 - u
    return v * v * (1 + 2 * u) * low + u * u * (1 + 2 * v) * high + u * v * h * (v * slope_low - u * slope_high)


def _index(places: Sequence[float], s: float) -> int:
    """The last of the rising `places` that is not above `s`, and not the very last."""
    return min(max(bisect_right(places, s) - 1, 0), len(places) - 2)


def _between(values: Sequence[float], s: float) -> float:
    """Linear between the places of a table."""
    cells = len(values) - 1
    i = min(int(s * cells), cells - 1)
    u = s * cells - i
    return (1 - u) * values[i] + u * values[i + 1]


def _beyond(values: Sequence[float], sums: Sequence[float], s: float) -> float:
    """The integral of a table from `s` to the tip."""
    cells = len(values) - 1
    i = min(int(s * cells), cells - 1)
    return sums[i + 1] + 0.5 * (_between(values, s) + values[i + 1]) * ((i + 1) / cells - s)


def _sums(values: Sequence[float]) -> list[float]:
    """The integral of a table from each of its places to the tip."""
    out = [0.0]
    for i in range(len(values) - 2, -1, -1):
        out.append(out[-1] + 0.5 * (values[i] + values[i + 1]) / (len(values) - 1))
    return out[::-1]


MU_BEYOND = _sums(MU_KG_M)
Q0_BEYOND = _sums(Q0_RAD)
GIVE = [1.0 / k for k in K_N_M]
