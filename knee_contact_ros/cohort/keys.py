"""What a case is, as a digest of its content: bag, parameters, the files they name, and the model that answers."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from knee_contact_ros.bags.provenance import model_digest
from knee_contact_ros.parameters.lateral import has_both
from knee_contact_ros.parameters.schema import Parameters

DIGITS = 32
"""Of a key, hexadecimal"""
NOT_COUNTED = {"autostart", "deadline", "diagnostics", "record", "rerun", "frame"}
"""Sections of the parameters that change no answer"""


def common_digest(bag: str, texts: Mapping[str, str]) -> bytes:
    """What all cases of a recording have in common: the bag's digest, the files' contents, and the model's source."""
    return repr((bag, sorted(texts.items()), _model())).encode()


@lru_cache
def _model() -> str:
    return model_digest()


def case_key(common: bytes, parameters: Parameters | None, values: Mapping[str, Any]) -> str:
    """The key of a case; of one whose parameters are not allowed, by its values."""
    if parameters is None:
        return _hashed(common, repr(sorted(values.items())))
    left_out = NOT_COUNTED if has_both(parameters) else NOT_COUNTED | {"lateral"}
    return _hashed(common, parameters.model_dump_json(exclude=left_out))


def _hashed(common: bytes, content: str) -> str:
    return hashlib.sha256(common + content.encode()).hexdigest()[:DIGITS]


def shard_name(keys: list[str]) -> str:
    """The name of the file that holds some cases."""
    return f"cases-{hashlib.sha256(' '.join(keys).encode()).hexdigest()[:DIGITS]}.parquet"
