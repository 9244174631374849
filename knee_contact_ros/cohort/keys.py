"""What a case is, as a digest of its content: bag, parameters, the files they name, and the model that answers."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from knee_contact_ros.bags.provenance import model_digest
from knee_contact_ros.cohort.outcomes import OUTCOMES
from knee_contact_ros.parameters.curves import curve_files
from knee_contact_ros.parameters.lateral import has_both
from knee_contact_ros.parameters.schema import Parameters

DIGITS = 32
"""Of a key, hexadecimal"""
NOT_COUNTED = {"autostart", "deadline", "diagnostics", "record", "rerun"}
"""Sections of the parameters that change no answer"""
MEANING = 1
"""Of the outcomes: one more when a column is computed otherwise"""


@lru_cache
def what_answers() -> str:
    """A digest of the model's source and of what the outcomes are: with another one, cases are others."""
    names = [outcome.name for outcome in OUTCOMES]
    return _digest(repr((model_digest(), MEANING, names)))


def case_key(bag: str, parameters: Parameters, texts: Mapping[str, str]) -> str:
    """The key of a case.

    Args:
        bag: Digest of the recording.
        parameters: Those of the case.
        texts: Contents of the files that they name, by parameter. What these are called does not count.
    """
    left_out = NOT_COUNTED if has_both(parameters) else NOT_COUNTED | {"lateral"}
    told = parameters
    if texts:
        digests = {name: _of_text(text) for name, text in texts.items()}
        told = _renamed(parameters, {name: digests[name] for name in curve_files(parameters)})
    return _digest(f"{what_answers()} {bag} {told.model_dump_json(exclude=left_out)}")


def refused_key(bag: str, common: Parameters, values: Mapping[str, Any]) -> str:
    """The key of a case whose parameters are not allowed, by the values that it has in place of the common ones."""
    return _digest(f"{what_answers()} {bag} {common.model_dump_json(exclude=NOT_COUNTED)} {sorted(values.items())!r}")


def _renamed(parameters: Parameters, names: Mapping[str, str]) -> Parameters:
    """Parameters with other names of files."""

    def with_value(section: Any, path: Sequence[str], value: str) -> Any:
        first, *rest = path
        inner = with_value(getattr(section, first), rest, value) if rest else value
        return section.model_copy(update={first: inner})

    for name, value in names.items():
        parameters = with_value(parameters, name.split("."), value)
    return parameters


@lru_cache(64)
def _of_text(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _digest(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()[:DIGITS]


def shard_name(keys: Sequence[str]) -> str:
    """The name of the file that holds some cases."""
    return f"cases-{_digest(' '.join(keys))}.parquet"
