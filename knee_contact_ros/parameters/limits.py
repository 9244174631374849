"""What a parameter may be, beyond its type: checked by pydantic, and told to those who ask (`Limits`)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from pydantic import GetCoreSchemaHandler
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema


class OneOf:
    """Allow these values only."""

    def __init__(self, *allowed: str | float) -> None:
        self.allowed = allowed
        numbers = [value for value in allowed if not isinstance(value, str)]
        self.least, self.most = min(numbers, default=-math.inf), max(numbers, default=math.inf)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check after the type."""
        return core_schema.no_info_after_validator_function(self._check, handler(source))

    def _check(self, value: Any) -> Any:
        if value not in self.allowed:
            raise ValueError(f"allowed: {self}")
        return value

    def __str__(self) -> str:
        return ", ".join(map(str, self.allowed))


class OffOrAtLeast:
    """Allow 0, which means something of its own (as a rule that it is off), and numbers from `least` on."""

    def __init__(self, least: float, zero: str = "off", numbers: str = "a number") -> None:
        self.least, self.most = 0.0, math.inf
        self._from = least
        self._words = f"0 ({zero}) or {numbers} >= {least:g}"

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check after the type."""
        return core_schema.no_info_after_validator_function(self._check, handler(source))

    def _check(self, value: Any) -> Any:
        if value != 0 and not value >= self._from:
            raise ValueError(f"allowed: {self}")
        return value

    def __str__(self) -> str:
        return self._words


class Limits(NamedTuple):
    """What a value may be."""

    least: float
    """Of a number; itself allowed unless `words` say otherwise"""
    most: float
    words: str
    """What the numbers alone do not tell: a list, an open end, a gap; of a text, what it is; empty if they tell all"""


def limits_of(field: FieldInfo) -> Limits:
    """The limits of a declared parameter."""
    least, most, words = -math.inf, math.inf, []
    for rule in field.metadata:
        if isinstance(rule, OneOf | OffOrAtLeast):
            least, most = max(least, rule.least), min(most, rule.most)
            words.append(str(rule))
        least, most = getattr(rule, "ge", least), getattr(rule, "le", most)  # the rules of annotated_types
        if hasattr(rule, "gt"):
            least = rule.gt
            words.append(f"> {least:g}")
        if hasattr(rule, "lt"):
            most = rule.lt
            words.append(f"< {most:g}")
    return Limits(least, most, "; ".join(words))
