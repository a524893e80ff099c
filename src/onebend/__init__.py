"""onebend: learn how stiff a soft slender object is along its length from one push, then bend it where you want.

Most work needs the verbs and records here. The rest is in `onebend.beam`, `recording`, `learning`, `control`, `lab`
(beams that do not exist or are still to be made), `design` (which push to make next), `paper` (the paper's own
regression), `forecast`, `streaming` (a camera and a sensor that still run), `results`, `records` and `errors`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import lazy_names

if TYPE_CHECKING:
    from onebend import beam as beam
    from onebend import control as control
    from onebend import design as design
    from onebend import errors as errors
    from onebend import forecast as forecast
    from onebend import lab as lab
    from onebend import learning as learning
    from onebend import paper as paper
    from onebend import progress as progress
    from onebend import recording as recording
    from onebend import records as records
    from onebend import results as results
    from onebend import streaming as streaming
    from onebend.beam.model import Beam as Beam
    from onebend.beam.model import Shape as Shape
    from onebend.beam.profiles.stiffness import Steps as Steps
    from onebend.beam.profiles.stiffness import Uniform as Uniform
    from onebend.beam.profiles.uncertain import Band as Band
    from onebend.beam.profiles.uncertain import UncertainStiffness as UncertainStiffness
    from onebend.control.loop.controller import controller as controller
    from onebend.control.path.follow import follow_goals as follow_goals
    from onebend.control.reach.reach import reach as reach
    from onebend.control.shape.shape import shape as shape
    from onebend.errors import OnebendError as OnebendError
    from onebend.learning.live.online_learner import OnlineLearner as OnlineLearner
    from onebend.learning.outcome import Comparison as Comparison
    from onebend.learning.posterior import Posterior as Posterior
    from onebend.learning.posterior import fit as fit
    from onebend.learning.replay import replay as replay
    from onebend.learning.sensing.sense import sense as sense
    from onebend.learning.swing.damping import learn_damping as learn_damping
    from onebend.learning.validation import validate as validate
    from onebend.pipeline import Run as Run
    from onebend.pipeline import learn as learn
    from onebend.recording.observe import observe as observe
    from onebend.records import Observations as Observations
    from onebend.results.model import load_model as load_model
    from onebend.results.model import load_uncertain as load_uncertain
    from onebend.results.model import save_model as save_model
    from onebend.results.observations_file import load_observations as load_observations
    from onebend.results.observations_file import save_observations as save_observations
    from onebend.streaming.live import Live as Live
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.beam.model": "Beam Shape",
            "onebend.beam.profiles.stiffness": "Steps Uniform",
            "onebend.beam.profiles.uncertain": "Band UncertainStiffness",
            "onebend.control.loop.controller": "controller",
            "onebend.control.path.follow": "follow_goals",
            "onebend.control.reach.reach": "reach",
            "onebend.control.shape.shape": "shape",
            "onebend.errors": "OnebendError",
            "onebend.learning.live.online_learner": "OnlineLearner",
            "onebend.learning.outcome": "Comparison",
            "onebend.learning.posterior": "Posterior fit",
            "onebend.learning.replay": "replay",
            "onebend.learning.sensing.sense": "sense",
            "onebend.learning.swing.damping": "learn_damping",
            "onebend.learning.validation": "validate",
            "onebend.pipeline": "Run learn",
            "onebend.recording.observe": "observe",
            "onebend.records": "Observations",
            "onebend.results.model": "load_model load_uncertain save_model",
            "onebend.results.observations_file": "load_observations save_observations",
            "onebend.streaming.live": "Live",
        },
        inside="beam control design errors forecast lab learning paper progress recording records results streaming",
    )

__version__ = "0.1.0"
