"""onebend: learn how stiff a soft slender object is along its length from one push, then bend it where you want.

Most work needs the verbs and records here. The rest is in `onebend.beam`, `recording`, `learning`, `control`, `lab`
(beams that do not exist or are still to be made), `design` (which push to make next), `paper` (the paper's own
regression), `forecast`, `streaming` (a camera and a sensor that still run), `results`, `records` and `errors`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import lazy_names, wings

if TYPE_CHECKING:
    from onebend import (
        beam as beam,
        control as control,
        errors as errors,
        learning as learning,
        progress as progress,
        recording as recording,
        records as records,
        results as results,
    )
    from onebend.beam.model import Beam as Beam, Shape as Shape
    from onebend.beam.stiffness import (
        Band as Band,
        Steps as Steps,
        UncertainStiffness as UncertainStiffness,
        Uniform as Uniform,
    )
    from onebend.control.loop import controller as controller
    from onebend.control.path import follow_goals as follow_goals
    from onebend.control.reach import reach as reach
    from onebend.control.shape import shape as shape
    from onebend.errors import OnebendError as OnebendError
    from onebend.learning.outcome import Comparison as Comparison
    from onebend.learning.posterior import Posterior as Posterior, fit as fit
    from onebend.learning.sensing.sense import sense as sense
    from onebend.learning.swing import learn_damping as learn_damping
    from onebend.learning.validation import validate as validate
    from onebend.pipeline import Run as Run, learn as learn
    from onebend.recording.observe import observe as observe
    from onebend.records import Observations as Observations
    from onebend.results.model import (
        load_model as load_model,
        load_uncertain as load_uncertain,
        save_model as save_model,
    )
    from onebend.results.observations_file import (
        load_observations as load_observations,
        save_observations as save_observations,
    )
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.beam.model": "Beam Shape",
            "onebend.beam.stiffness": "Band Steps UncertainStiffness Uniform",
            "onebend.control.loop": "controller",
            "onebend.control.path": "follow_goals",
            "onebend.control.reach": "reach",
            "onebend.control.shape": "shape",
            "onebend.errors": "OnebendError",
            "onebend.learning.outcome": "Comparison",
            "onebend.learning.posterior": "Posterior fit",
            "onebend.learning.sensing.sense": "sense",
            "onebend.learning.swing": "learn_damping",
            "onebend.learning.validation": "validate",
            "onebend.pipeline": "Run learn",
            "onebend.recording.observe": "observe",
            "onebend.records": "Observations",
            "onebend.results.model": "load_model load_uncertain save_model",
            "onebend.results.observations_file": "load_observations save_observations",
        },
        inside=" ".join(("beam control errors learning progress recording records results", *wings())),
    )

__version__ = "0.1.0"
