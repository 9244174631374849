"""The Arrow table of a study: a row for each case, with a column for every parameter that a study may vary.

So tables of several studies fit together, and every row describes its knee completely.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np
import pyarrow as pa

from knee_contact_ros.cohort.computing import Computed, outcomes_of
from knee_contact_ros.cohort.knees import Knees, Values, may_vary
from knee_contact_ros.cohort.outcomes import OUTCOMES
from knee_contact_ros.model.types import FLAT, TOLD
from knee_contact_ros.parameters.lateral import LATERAL as LATERAL_KNEE
from knee_contact_ros.parameters.reading import all_values, known_parameters

LATERAL = "lateral_"
"""Prefix of the columns with outcomes of the lateral compartment"""
TYPES = {float: pa.float64(), int: pa.int64(), bool: pa.bool_(), str: pa.string()}
BEFORE = (
    ("case", pa.string(), "key of the case: a digest of bag, parameters and model"),
    ("bag", pa.string(), "as the study names it"),
    ("params", pa.string(), "parameter files, as the study names them"),
)
AFTER = (
    ("failed", pa.string(), "why there is no outcome; empty if there is one"),
    ("seconds", pa.float64(), "[s] that the case took, one of many computed together"),
)


@lru_cache
def schema() -> pa.Schema:
    """Give the names and types of the columns; their meanings are in the fields' metadata."""
    fields = [_field(*column) for column in BEFORE]
    for name, declared in known_parameters().items():
        if may_vary(name):
            fields.append(_field(name, TYPES[type(declared.default)], declared.description))
    for prefix, compartment in (("", ""), (LATERAL, " of the lateral compartment")):
        for outcome in OUTCOMES:
            unit = f"[{outcome.unit}] " if outcome.unit else ""
            fields.append(_field(prefix + outcome.name, pa.float64(), f"{unit}{outcome.meaning}{compartment}"))
    return pa.schema([*fields, *(_field(*column) for column in AFTER)])


def _field(name: str, kind: pa.DataType, meaning: str) -> pa.Field:
    return pa.field(name, kind, metadata={"meaning": meaning})


def table_of(
    keys: Sequence[str], bag: str, params: Sequence[str], knees: Knees, cases: Sequence[Values],
    computed: Sequence[Computed],
) -> pa.Table:  # fmt: skip
    """Make the table of cases of one recording and one set of parameter files.

    Args:
        keys: Keys of the cases.
        bag: The recording, as the study names it.
        params: The parameter files, as the study names them.
        knees: What the cases have in common.
        cases: Values of the varied parameters of each case.
        computed: Results of the cases.
    """
    number = len(cases)
    columns: dict[str, Any] = {"case": list(keys), "bag": [bag] * number, "params": [" + ".join(params)] * number}
    columns |= _values_of(knees, cases, computed)
    for side, prefix in enumerate(("", LATERAL)):
        rows = outcomes_of(computed, side)
        columns |= {prefix + outcome.name: rows[outcome.name] for outcome in OUTCOMES}
    columns["failed"] = [one.failed for one in computed]
    columns["seconds"] = [one.seconds for one in computed]
    return pa.table({name: columns[name] for name in schema().names}, schema=schema())


def _values_of(knees: Knees, cases: Sequence[Values], computed: Sequence[Computed]) -> dict[str, Any]:
    """Make the columns of the parameters that a study may vary; what all cases have in common is looked up once."""
    columns: dict[str, Any] = {}
    varied = {name for values in cases for name in values}
    for name, common in all_values(knees.parameters).items():
        if {name, name.removeprefix(LATERAL_KNEE)} & varied:
            value_in = attrgetter(name)
            columns[name] = [value_in(one.parameters) if one.parameters else values.get(name, common)
                             for one, values in zip(computed, cases, strict=True)]  # fmt: skip
        elif may_vary(name):
            columns[name] = pa.repeat(pa.scalar(common, schema().field(name).type), len(cases))
    return columns


def series_of(keys: Sequence[str], computed: Sequence[Computed]) -> pa.Table:
    """Make the table of all answers of the cases: key, compartment, stamp [ns], and the fields of the message."""
    parts = [
        (key, side, rows)
        for key, one in zip(keys, computed, strict=True)
        for side, rows in zip(("medial", "lateral"), one.series, strict=False)
    ]
    names = ("stamp", *TOLD)
    rows = np.concatenate([rows for *_, rows in parts]).view(FLAT) if parts else np.zeros(0, FLAT)
    lengths = [len(rows) for *_, rows in parts]
    columns: dict[str, Any] = {
        "case": pa.array(np.repeat([key for key, *_ in parts], lengths).tolist(), pa.string()),
        "compartment": pa.array(np.repeat([side for _, side, _ in parts], lengths).tolist(), pa.string()),
    }
    return pa.table(columns | {name: np.ascontiguousarray(rows[name]) for name in names})
