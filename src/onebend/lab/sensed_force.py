"""A simulated loop that senses the force from the beam's shape, with hand-placed, noisy tags."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.setup import SetUp
from onebend.beam.stiffness import UncertainStiffness
from onebend.control.loop import Controller, Exposure, ForceSense, LoggedForce
from onebend.control.loop_simulation import along
from onebend.errors import ControlError
from onebend.lab.bench import PushProfile, TagNoise, filmed
from onebend.lab.virtual import (
    DeclaredValues,
    VirtualBench,
    VirtualTag,
    declared_recording,
    from_base,
    markers_of,
    tag_places,
    tag_poses_on,
)
from onebend.learning.sensing.sense import LiveForce, OnlineSense, SenseSettings
from onebend.recording.beam_frame import beam_turn, rest_shape, to_beam_frame, turned
from onebend.recording.observe import LoadsAtFrames, observations_of
from onebend.records import Array, Markers, Observations, Source

_REST = 30  # frames of the unloaded beam
_STEP = 1.0 / 30.0  # s
_USUAL = (0.25, 0.5, 0.75, 1.0)  # of s: tags if the model knows none
_AT_POINT = 0.02  # of s: a tag this near a hidden point is hidden too
_LOG_NOISE = 0.01  # N, sd per sample
FeltBy = Literal["nothing", "log", "shape"]


@dataclass(frozen=True)
class SensedTags:
    """The tags of a simulated loop, and their errors."""

    tags: tuple[VirtualTag, ...]
    base: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, m, rad: base tag in the clamp's frame
    noise: TagNoise = field(default_factory=TagNoise)
    placement_sd: float = 5e-4  # m, stated
    gravity: tuple[float, float] = (0.0, 0.0)  # m/s^2


def drawn_tags(places: Sequence[float], rng: np.random.Generator, *, placement_sd: float = 5e-4) -> SensedTags:
    """Tags at `places` of s, with random errors of the tolerance; so is the base tag."""
    off = rng.normal(0.0, placement_sd, (len(places), 2))
    tags = [VirtualTag(i + 1, s, *away) for i, (s, away) in enumerate(zip(places, off.tolist(), strict=True))]
    x, y = rng.normal(0.0, placement_sd, 2).tolist()
    base = (x, y, float(rng.normal(0.0, np.radians(1.0))))
    return SensedTags(tuple(tags), base, placement_sd=placement_sd)


def felt_by(
    what: FeltBy,
    control: Controller,
    *,
    stiffness: UncertainStiffness | None = None,
    setup: SetUp | None = None,
    force_off: float = 0.0,
    hidden: bool = False,
    seed: int = 0,
) -> Callable[[Beam], ForceSense] | None:
    """For `simulate_range`: nothing; a log off by `force_off` [N] along the model's force; or the shape from tags at
    the places of the `setup`, put on anew, without those on the point if it is `hidden`."""
    if what == "nothing":
        return None
    if what == "log":
        bias = force_off * along(control)
        return lambda _: LoggedForce(bias, noise=_LOG_NOISE, sd=max(force_off, _LOG_NOISE), seed=seed)
    places = _USUAL if setup is None else setup.tags
    shown = [s for s in places if not (hidden and abs(s - control.point_s) < _AT_POINT)]
    if len(shown) < 2:
        raise ControlError("the shape tells no force: of the tags, fewer than two are seen beside the hidden point")
    drawn = drawn_tags(shown, np.random.default_rng([seed, 1]))
    x, y = control.gravity.tolist()
    seen = replace(drawn, gravity=(x, y))

    def of(truth: Beam) -> SensedForce:
        model = replace(control.beam, mass_per_length=truth.mass_per_length)
        return SensedForce(model, truth, seen, push_s=control.push_s, stiffness=stiffness, setup=setup, seed=seed)

    return of


class SensedForce:
    """The force on a beam from its shape, for `simulate_loop`. It keeps the last frame: use one per run.

    The scale of k is left out of the region: the loop compares with the model's force, which shares it.
    """

    def __init__(
        self,
        model: Beam,
        truth: Beam,
        seen: SensedTags,
        *,
        push_s: float,
        stiffness: UncertainStiffness | None = None,
        setup: SetUp | None = None,
        seed: int = 0,
    ) -> None:
        """`truth` moves; `model` is the learned beam with the band `stiffness`. Raises `LearningError`: as `sense`."""
        declared = DeclaredValues(length=model.length, placement_sd=seen.placement_sd)
        self._bench = VirtualBench(
            truth, PushProfile(1.0, at_s=push_s), seen.tags, seen.base, declared=declared, name="simulated loop"
        )
        self._seen, self._rng = seen, np.random.default_rng(seed)
        rest = truth.equilibrium((0.0, 0.0))
        s = self._places
        still = np.repeat(np.column_stack([rest.xy(s), rest.angle(s)])[None], _REST, axis=0)
        shown = self._markers(np.arange(_REST, dtype=np.float64) * _STEP, still)
        nothing = np.ones(_REST, dtype=bool)
        self._turn = beam_turn(rest_shape(shown, nothing), seen.placement_sd)
        at_rest = _at_rest(shown, self._bench, seen)
        relative = None if stiffness is None else replace(stiffness, gain_sd=0.0)
        anew = SenseSettings(tags="anew")
        self._live = OnlineSense(model, at_rest, stiffness=relative, setup=setup, settings=anew)

    def __call__(self, seen: Exposure) -> LiveForce:
        shown = turned(
            self._markers(np.full(1, seen.time, dtype=np.float64), seen.pose(self._places)[None]), self._turn
        )
        return self._live.add(seen.time, shown.xy[0], shown.angle[0], shown.covariance[0])

    @property
    def _places(self) -> Array:
        return np.clip(tag_places(self._bench), 0.0, 1.0)

    def _markers(self, time: Array, beam: Array) -> Markers:
        """Markers on a beam with the poses `beam` (T, m, 3) at their places."""
        pose = from_base(tag_poses_on(self._bench, beam[..., :2], beam[..., 2]), self._seen.base)
        poses, covariance = filmed(self._seen.noise, pose, _STEP, self._rng)
        return markers_of(self._seen.tags, time, poses, covariance)


def _at_rest(shown: Markers, bench: VirtualBench, seen: SensedTags) -> Observations:
    count, nothing = len(shown.time), np.zeros((len(shown.time), 2))
    in_frame, rest, _ = to_beam_frame(shown, np.ones(count, dtype=bool), seen.placement_sd, nothing)
    gravity, push_s = np.tile(np.asarray(seen.gravity), (count, 1)), np.full(count, bench.push.at_s)
    loads = LoadsAtFrames(shown.time, gravity, nothing, push_s, np.zeros(count, dtype=bool))
    source, use = Source("simulated loop"), np.ones(count, dtype=bool)
    return observations_of(declared_recording(bench), source, in_frame, rest, loads, np.zeros(2), use)
