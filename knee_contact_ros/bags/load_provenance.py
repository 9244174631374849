"""Provenance of a recording of estimated joint reactions."""

from __future__ import annotations

import json
from pathlib import Path

from knee_contact_ros import __version__
from knee_contact_ros.bags.provenance import NOT_OF_THE_RESULT, bag_digest
from knee_contact_ros.parameters.files import flat_parameters
from knee_contact_ros.parameters.schema import LoadParameters
from knee_contact_ros.streams.output import LOAD_PROVENANCE

__all__ = ["LOAD_PROVENANCE", "load_provenance_record"]


def load_provenance_record(
    parameters: LoadParameters, source: Path | None = None, ticks_before: int = 0
) -> dict[str, str]:
    """Content of the metadata record; nothing in it depends on where or when it is written.

    Args:
        parameters: Parameters of the estimate.
        source: Bag that the inputs come from, if any.
        ticks_before: Number of ticks that the node had computed before the recording began.
    """
    values = flat_parameters(parameters)
    kept = {name: value for name, value in values.items() if not name.startswith(NOT_OF_THE_RESULT)}
    record = {
        "package": f"knee_contact_ros {__version__}",
        "level": parameters.chosen_level,
        "parameters": json.dumps(kept, indent=0),
        "ticks_before": str(ticks_before),
    }
    return record | ({"source": source.name, "source_sha256": bag_digest(source)} if source else {})
