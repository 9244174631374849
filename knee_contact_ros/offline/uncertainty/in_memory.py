"""`knee_contact_ros.uncertainty`: standard deviations of the answers to a recorded gait, as a function of Python."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from knee_contact_ros.offline.in_memory import Name, in_python_words, solve_inputs
from knee_contact_ros.offline.solve import parameters_in
from knee_contact_ros.offline.uncertainty.deviations import deviations_of, read_deviations
from knee_contact_ros.offline.uncertainty.propagation import Propagated, Sampled, propagated, sampled
from knee_contact_ros.offline.uncertainty.replay import Given, given_in
from knee_contact_ros.parameters.reading import Source, dotted
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.resources import expanded
from knee_contact_ros.system.terminal import progress


@dataclass(frozen=True)
class Uncertainty:
    """Result of `uncertainty`: standard deviations of each compartment's answers, and the inputs they follow from."""

    medial: Propagated
    """Standard deviations of the medial compartment, or of the only one"""
    lateral: Propagated | None
    """Standard deviations of the lateral compartment, where both are modelled"""
    given: Given
    """Inputs and parameters of the recording"""

    def sampled(self, samples: int = 200, seed: int = 0) -> list[Sampled]:
        """Compare the linear propagation with random samples of all inputs at once, for each compartment.

        Raises:
            UsageError: fewer than 2 samples, or none of them lies in the parameters' ranges.
        """
        if samples < 2:
            raise UsageError(f"samples: {samples} is not allowed; 2 or more")
        linear = [self.medial, *([self.lateral] if self.lateral else [])]
        with progress("Sampling") as advance:
            return sampled(self.given.ready_for(samples), linear, samples, seed, advance)


def uncertainty(
    bag: Name | None = None,
    params: Source | None = None,
    deviations: Mapping[str, Any] | Name | None = None,
    values: Mapping[str, Any] | None = None,
    *,
    subject: Name | None = None,
    remap: Mapping[str, str] | None = None,
    namespace: str = "",
    compiled: bool | None = None,
) -> Uncertainty:
    """Propagate standard deviations of inputs and parameters to the depth and force of a recorded gait.

    Args:
        bag: This, and all other arguments but `deviations`, are as for `solve`.
        params: Parameters of the knee.
        deviations: Standard deviations by name, or a YAML file of them: of `flexion_angle` [rad], `axial_load` ([N] or
            `"5 %"`), `medial_share`, `femoral_height` [m], and of parameters that are real numbers, in SI units or in
            percent: `{"contact.stiffness": "20 %"}`. Each is constant through the recording, and independent of the
            others.
        values: Single parameters, which win over all others.
        subject: A subject file.
        remap: Other names of the inputs in the bag.
        namespace: Namespace of the inputs in the bag.
        compiled: As for `load_model`.

    Raises:
        UsageError: an argument cannot be used, or parameters changed while the recording was made.
    """
    with in_python_words():
        path, basis, names = solve_inputs(bag, params, values, subject, remap, namespace)
        sizes = deviations or {}
        sizes = dotted(sizes) if isinstance(sizes, Mapping) else read_deviations(Path(expanded(str(sizes))))
        wanted = deviations_of(sizes, parameters_in(basis))
        with progress("Solving") as advance:
            given = given_in(path, basis, advance, names, replays=2 * len(wanted), compiled=compiled)
        with progress("Propagating") as advance:
            medial, *lateral = propagated(given, wanted, advance)
    return Uncertainty(medial, lateral[0] if lateral else None, given)
