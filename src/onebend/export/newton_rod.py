"""A slender beam for Newton (the package `newton`): capsules joined by rod joints, for SolverVBD.

    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -9.81))
    bodies, joints = add_beam(builder)
    builder.color()
    model = builder.finalize()
    solver = newton.solvers.SolverVBD(model, iterations=100)
    relaxation = JointRelaxation(model, solver, joints)  # where RELAXATION is not empty: relaxation.step(state, dt)

Body i is link i + 1 of the chain; link 0 is the world. A body's z axis lies along its link. SolverVBD is soft where it
has too few iterations: a light stiff beam needs many, and steps of `TIME_STEP_S`. Look whether twice as many iterations
move the tip.
"""

import math
from typing import Any

import newton
import numpy as np
import warp as wp

# --- the beam -------------------------------------------------------------------------------------------------------
LENGTH_M = 1.0
CLAMP_ANGLE_RAD = 0.0
LINK_LENGTH_M: tuple[float, ...] = (0.25, 0.5, 0.25)
LINK_MASS_KG: tuple[float, ...] = (0.25, 0.5, 0.25)
LINK_CENTRE_M: tuple[float, ...] = (0.125, 0.25, 0.125)
LINK_INERTIA_KG_M2: tuple[float, ...] = (1e-3, 1e-2, 1e-3)
BEND_N_M: tuple[float, ...] = (1.0, 1.0)  # per radian: EI over the length of a cell
REST_RAD: tuple[float, ...] = (0.0, 0.0)
STRETCH_N_M: tuple[float, ...] = (1e4, 1e4)  # EA over the length of a link
SHEAR_N_M: tuple[float, ...] = (1e4, 1e4)
DAMPING_TIME_S = 0.02  # damping over stiffness
RELAXATION: tuple[tuple[float, float], ...] = ()  # shares of BEND_N_M that relax, and their times in s
# --------------------------------------------------------------------------------------------------------------------

TIME_STEP_S = math.sqrt(min(LINK_MASS_KG[1:-1]) / max(STRETCH_N_M))  # in which a stretch wave passes one link


def add_beam(
    builder: newton.ModelBuilder, xform: Any = None, radius: float | None = None
) -> tuple[list[int], list[int]]:
    """The bodies and the joints. The beam begins straight; where it is curved at rest it moves there.

    `xform`: of the clamp; the beam lies along its x axis and bends about its z axis. `radius`: m, of the capsules that
    are drawn and touched; None adds none.
    """
    turn = wp.mul(wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), CLAMP_ANGLE_RAD), _ALONG)
    clamp = wp.mul(wp.transform() if xform is None else xform, wp.transform(wp.vec3(), turn))
    least = 0.1 * min(LINK_INERTIA_KG_M2)  # Newton would raise the inertia of a light link to 1e-6 kg m^2
    builder.inertia_absolute_tolerance = min(builder.inertia_absolute_tolerance, least)
    bodies: list[int] = []
    joints: list[int] = []
    begins = 0.0
    for i, bend in enumerate(BEND_N_M):
        begins += LINK_LENGTH_M[i]
        inertia, half = LINK_INERTIA_KG_M2[i + 1], 0.5 * LINK_LENGTH_M[i + 1]
        at = wp.mul(clamp, wp.transform(wp.vec3(0.0, 0.0, begins), wp.quat_identity()))
        body = builder.add_link(
            xform=at,
            mass=LINK_MASS_KG[i + 1],
            com=wp.vec3(0.0, 0.0, LINK_CENTRE_M[i + 1]),
            inertia=wp.mat33(inertia, 0.0, 0.0, 0.0, inertia, 0.0, 0.0, 0.0, inertia),
            lock_inertia=True,
            label=f"link_{i + 1}",
        )
        if radius is not None:
            middle = wp.transform(wp.vec3(0.0, 0.0, half), wp.quat_identity())
            builder.add_shape_capsule(body, xform=middle, radius=radius, half_height=half)
        end = wp.transform(wp.vec3(0.0, 0.0, LINK_LENGTH_M[i]), wp.quat_identity())
        joint = builder.add_joint_rod(
            bodies[-1] if bodies else -1,
            body,
            parent_xform=end if bodies else at,
            child_xform=wp.transform_identity(),
            rest_rotation=_turned(REST_RAD[i]),
            stretch_stiffness=STRETCH_N_M[i],
            stretch_damping=DAMPING_TIME_S * STRETCH_N_M[i],
            shear_stiffness=SHEAR_N_M[i],
            shear_damping=DAMPING_TIME_S * SHEAR_N_M[i],
            bend_stiffness=bend,
            bend_damping=DAMPING_TIME_S * bend,
            label=f"hinge_{i}",
        )
        bodies.append(body)
        joints.append(joint)
    builder.add_articulation(joints)
    return bodies, joints


_ALONG = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), 0.5 * math.pi)  # z onto x; the clamp's z is then -x


def _turned(angle: float) -> wp.quat:
    return wp.quat_from_axis_angle(wp.vec3(-1.0, 0.0, 0.0), float(angle))


class JointRelaxation:
    """What relaxes of a turn moves the turn at rest: `M = K (theta - sum a v)`, `tau v' = theta - v`."""

    def __init__(self, model: newton.Model, solver: Any, joints: list[int]) -> None:
        self.model, self.solver, self.rest = model, solver, np.asarray(REST_RAD)
        self.places = model.joint_q_start.numpy()[joints] + 3
        self.child, self.parent = model.joint_child.numpy()[joints], model.joint_parent.numpy()[joints]
        self.clamp = model.joint_X_p.numpy()[joints[0], 3:]
        self.lagging = np.zeros((len(RELAXATION), len(joints)))

    def step(self, state: newton.State, dt: float) -> None:
        """After every step of `dt` s, or of several together. Not within a captured graph."""
        q = state.body_q.numpy()[:, 3:]
        before = np.where((self.parent < 0)[:, None], self.clamp, q[self.parent])
        x, y, z, w = (before * [-1.0, -1.0, -1.0, 1.0]).T
        cx, cy, cz, cw = q[self.child].T  # the turn about -x from parent to child
        turn = 2.0 * np.arctan2(-(w * cx + x * cw + y * cz - z * cy), w * cw - x * cx - y * cy - z * cz)
        turn = np.remainder(turn + math.pi, 2.0 * math.pi) - math.pi - self.rest
        for v, (_, tau) in zip(self.lagging, RELAXATION, strict=True):
            v -= math.expm1(-dt / tau) * (turn - v)
        moved = self.rest + sum(a * v for (a, _), v in zip(RELAXATION, self.lagging, strict=True))
        rest = self.model.joint_rest_q.numpy()
        rest[self.places], rest[self.places + 3] = -np.sin(0.5 * moved), np.cos(0.5 * moved)
        self.model.joint_rest_q.assign(rest)
        self.solver.notify_model_changed(newton.ModelFlags.JOINT_REFERENCE_POSE_PROPERTIES)
