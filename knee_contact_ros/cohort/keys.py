"""Keys of cases: digests of bag, parameters, the files that these name, and the model that answers."""

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
"""Number of hexadecimal digits of a key"""
NOT_COUNTED = {"autostart", "deadline", "diagnostics", "record", "rerun"}
"""Sections of the parameters that change no answer, and so no key"""
MEANING = 1
"""Version of the outcomes' definitions: to be increased when a column is computed in another way"""


@lru_cache
def what_answers() -> str:
    """Give a digest of the model's source and of the outcomes' definitions; every key depends on it."""
    names = [outcome.name for outcome in OUTCOMES]
    return _digest(repr((model_digest(), MEANING, names)))


def case_key(bag: str, parameters: Parameters, texts: Mapping[str, str]) -> str:
    """Make the key of a case.

    Args:
        bag: Digest of the recording.
        parameters: All parameters of the case.
        texts: Contents of the files that the parameters name, by parameter. The names of the files do not count.
    """
    left_out = NOT_COUNTED if has_both(parameters) else NOT_COUNTED | {"lateral"}
    if texts:
        parameters = _renamed(parameters, {name: _digest_of_text(texts[name]) for name in curve_files(parameters)})
    return _digest(f"{what_answers()} {bag} {parameters.model_dump_json(exclude=left_out)}")


def refused_key(bag: str, common: Parameters, values: Mapping[str, Any]) -> str:
    """Make the key of a case whose parameters are not allowed, from the common parameters and its own values."""
    return _digest(f"{what_answers()} {bag} {common.model_dump_json(exclude=NOT_COUNTED)} {sorted(values.items())!r}")


def _renamed(parameters: Parameters, names: Mapping[str, str]) -> Parameters:
    """Give parameters with other names of files."""

    def with_value(section: Any, path: Sequence[str], value: str) -> Any:
        first, *rest = path
        inner = with_value(getattr(section, first), rest, value) if rest else value
        return section.model_copy(update={first: inner})

    for name, value in names.items():
        parameters = with_value(parameters, name.split("."), value)
    return parameters


@lru_cache(64)
def _digest_of_text(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _digest(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()[:DIGITS]


def shard_name(keys: Sequence[str]) -> str:
    """Make the name of the file that holds the cases of some keys."""
    return f"cases-{_digest(' '.join(keys))}.parquet"
