from . import (
    beam as beam,
    control as control,
    errors as errors,
    lab as lab,
    learning as learning,
    live as live,
    many as many,
    progress as progress,
    recording as recording,
    records as records,
    results as results,
    studio as studio,
)
from .beam.model import Beam as Beam, Shape as Shape
from .beam.stiffness import Band as Band, Steps as Steps, UncertainStiffness as UncertainStiffness, Uniform as Uniform
from .control.loop import controller as controller
from .control.path import follow_goals as follow_goals
from .control.reach import reach as reach
from .control.shape import shape as shape
from .errors import OnebendError as OnebendError
from .learning.outcome import Comparison as Comparison
from .learning.posterior import Posterior as Posterior, fit as fit
from .learning.sensing.sense import sense as sense
from .learning.swing import learn_damping as learn_damping
from .learning.validation import validate as validate
from .pipeline import Run as Run, learn as learn
from .recording.observe import observe as observe
from .records import Observations as Observations
from .results.model import load_model as load_model, load_uncertain as load_uncertain, save_model as save_model
from .results.observations_file import load_observations as load_observations, save_observations as save_observations

__version__: str
