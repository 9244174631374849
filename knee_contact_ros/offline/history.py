"""Do again, in an offline run, what happened to the node that made the recording."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from knee_contact_ros.bags.provenance import PARAMETERS_CHANGED, RESET, TICK, Change, change_record
from knee_contact_ros.parameters.reading import all_values, load_parameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.pipeline import Pipeline
from knee_contact_ros.system.errors import UsageError


class Changes:
    """Changes that wait for their tick."""

    def __init__(self, changes: Iterable[Change]) -> None:
        self._waiting = deque(changes)

    @property
    def waiting(self) -> bool:
        """Whether there are any left."""
        return bool(self._waiting)

    def make(self, pipeline: Pipeline) -> Iterator[tuple[str, dict[str, str]]]:
        """Make those whose tick has come; give the metadata record of each.

        Raises:
            UsageError: parameters that this version does not allow.
        """
        while self._waiting and pipeline.ticks >= self._waiting[0].tick:
            tick, values = self._waiting.popleft()
            if values is None:
                pipeline.reset()
                yield RESET, {TICK: str(tick)}
            else:
                pipeline.retune(_changed(pipeline, tick, values))
                yield PARAMETERS_CHANGED, change_record(tick, values)


def _changed(pipeline: Pipeline, tick: int, values: Mapping[str, Any]) -> Parameters:
    try:
        return load_parameters(all_values(pipeline.parameters) | dict(values))
    except UsageError as error:
        raise UsageError(f"the recording tells of a change after {tick} ticks that cannot be made: {error}") from None
