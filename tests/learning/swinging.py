"""A beam let go in thought: the film of its tags, from a finer simulation than the one that learns from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.beam.dynamics import Actions, AppliedForce, body
from onebend.beam.grid import Modes
from onebend.beam.integration import simulate
from onebend.beam.model import Beam
from onebend.beam.stiffness import LogSpline, Scaled, Uniform
from onebend.beam.vibration import settle
from onebend.records import ClockOffset, Observations
from tests import made_up
from tests.made_up import with_source, with_stated

TAU = 0.004  # s
BEAM = Beam(0.15, LogSpline(tuple([0.0] * 4 + [1.0] * 4), tuple(np.log([0.03, 0.015, 0.015, 0.03]).tolist())))
MASS = 0.1  # kg/m
HEAVY = replace(BEAM, mass_per_length=Uniform(MASS))
RELEASE, RATE = 0.537, 60.0  # s on the film's clock, between two frames; frames/s
OFFSET = 40.0  # s, log's clock less the film's


def released(
    *, beam: Beam = HEAVY, tau: float = TAU, seconds: float = 1.3, noise: float = 5e-5, seed: int = 0, pull: float = 0.3
) -> Observations:
    """Held by a force at the tip, let go at RELEASE; noise in m on places, in 20 rad/m times that on angles."""
    on = body(beam, Modes(12), damping=Scaled(tau, beam.stiffness))
    held = settle(on, Actions(forces=(AppliedForce((0.1 * pull, pull)),)))
    time = np.arange(round((RELEASE + seconds) * RATE)) / RATE
    free = time > RELEASE
    motion = simulate(on, held, float(time[-1]) - RELEASE + 1e-9, 1e-3)
    theta = np.where(free[:, None], motion.states_at(np.maximum(time - RELEASE, 0.0)), held.theta)
    rng = np.random.default_rng(seed)
    xy, angle = on.xy(made_up.MARKER_S, theta), on.angle(made_up.MARKER_S, theta)
    xy = xy + noise * rng.standard_normal(xy.shape)
    angle = angle + 20.0 * noise * rng.standard_normal(angle.shape)
    xy[free & (time < RELEASE + 0.2), 2] = np.nan  # the tip tag is too fast to be read at first
    return with_stated(
        with_source(
            replace(
                made_up.observations(),
                time=time + OFFSET,
                frame=np.arange(len(time)),
                xy=xy,
                angle=angle,
                covariance=np.broadcast_to(
                    np.diag([noise**2, noise**2, (20.0 * noise) ** 2]) + 1e-16 * np.eye(3), (len(time), 3, 3, 3)
                ),
                force=np.where(free[:, None], 0.0, np.array([0.1 * pull, pull])),
                push_s=np.ones(len(time)),
                loaded=~free,
                gravity=np.zeros((len(time), 2)),
            ),
            clock=ClockOffset(offset=OFFSET, sd=0.002, stated=OFFSET, found=True),
        ),
        mass=float("nan"),
    )
