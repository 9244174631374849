"""`knee_contact_ros.uncertainty`: the uncertainty of a recorded gait's answers, for a notebook."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from knee_contact_ros.bags.provenance import Provenance
from knee_contact_ros.offline.in_memory import Name, asked_in_python, in_python_words
from knee_contact_ros.offline.uncertainty.deviations import deviations_of, read_deviations
from knee_contact_ros.offline.uncertainty.propagation import Propagated, Sampled, propagated, sampled
from knee_contact_ros.offline.uncertainty.replay import Given, given_in
from knee_contact_ros.parameters.reading import Source, dotted
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.resources import expanded
from knee_contact_ros.system.terminal import progress


@dataclass(frozen=True)
class Uncertainty:
    """What `uncertainty` gives: the standard deviations of each compartment, and what they were made from."""

    medial: Propagated
    """Of the medial compartment, or the only one"""
    lateral: Propagated | None
    """Of the lateral one, where both are modelled"""
    given: Given

    def sampled(self, samples: int = 200, seed: int = 0) -> list[Sampled]:
        """Hold the straight lines against so many samples of all inputs at once, for each compartment.

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
    """Depth and force of a recorded gait with the standard deviations that those of inputs and parameters make.

    Args:
        bag: This, and all other arguments but `deviations`, are as for `solve`.
        params: The knee.
        deviations: Standard deviations by name, or a YAML file of them: of `flexion_angle` [rad], `axial_load` ([N] or
            `"5 %"`), `medial_share`, `femoral_height` [m], and of parameters that are real numbers, in SI units or in
            percent: `{"contact.stiffness": "20 %"}`. Each is constant through the recording, and independent of the
            others.
        values: Single parameters.
        subject: A subject file.
        remap: Other names of the inputs.
        namespace: Of the inputs.
        compiled: As for `load_model`.

    Raises:
        UsageError: one of them cannot be used, or parameters changed while the recording was made.
    """
    with in_python_words():
        path, how, names = asked_in_python(bag, params, values, subject, remap, namespace)
        told = deviations or {}
        read = dotted(told) if isinstance(told, Mapping) else read_deviations(Path(expanded(str(told))))
        parameters = how.parameters if isinstance(how, Provenance) else how
        asked = deviations_of(read, parameters)
        with progress("Solving") as advance:
            given = given_in(path, how, advance, names, replays=2 * len(asked), compiled=compiled)
        with progress("Propagating") as advance:
            medial, *lateral = propagated(given, asked, advance)
    return Uncertainty(medial, lateral[0] if lateral else None, given)
