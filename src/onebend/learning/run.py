"""What learning from recordings, and validating on others, gave."""

from __future__ import annotations

from dataclasses import dataclass

from onebend.beam.model import Beam
from onebend.beam.section import ModulusBand, one_modulus
from onebend.learning.outcome import Comparison, Learned, modulus_along, stated_section
from onebend.learning.posterior import Posterior
from onebend.records import Array, Observations, Remark


@dataclass(frozen=True)
class Run:
    """Everything that came out of learning from recordings and validating on others."""

    beam: Beam  # what was learned: the fit's, where there is one
    learned: Learned | None  # the paper's regression on the first recording; None where no (n, m) gave a beam
    posterior: Posterior | None  # the fit over all recordings; None where only the regression was asked for
    recordings: tuple[Observations, ...]  # learned from
    trainings: tuple[Comparison, ...]  # the beam against each of them
    validations: tuple[Comparison, ...]
    validation_observations: tuple[Observations, ...]
    remarks: tuple[Remark, ...]  # on the learning itself

    def modulus(self, s: Array, level: float = 0.95) -> ModulusBand | None:
        """Young's modulus E(s) [Pa] at places s (S,), with its band if k(s) has one; None if no section is stated."""
        uncertain = None if self.posterior is None else self.posterior.stiffness
        return modulus_along(self.beam, uncertain, stated_section(self.recordings), s, level)

    def one_modulus(self, level: float = 0.95) -> tuple[float, float, float] | None:
        """Young's modulus [Pa] as one number, and its band; None if `stiffness_along` is not "section"."""
        if self.posterior is None:
            return None
        return one_modulus(self.posterior.stiffness, self.beam.length, stated_section(self.recordings), level)
