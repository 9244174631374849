"""Allowed values of a parameter, beyond its type: checked by pydantic, and described for people (`Limits`)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from pydantic import GetCoreSchemaHandler
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema


class Rule:
    """Rule for the values of a parameter, which pydantic checks after their type. A subclass says what it allows."""

    def __init__(self, allows: Callable[[Any], bool], words: str, least: float, most: float = math.inf) -> None:
        """Allow some values, described by `words`; numbers among them lie between `least` and `most`."""
        self.words, self.least, self.most = words, least, most
        self._allows = allows

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Schema of the type, with the check behind it."""
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def _checked(self, value: Any) -> Any:
        if not self._allows(value):
            raise ValueError(f"allowed: {self.words}")
        return value


class OneOf(Rule):
    """Rule that allows some values only."""

    def __init__(self, *allowed: str | float) -> None:
        """Allow these values."""
        numbers = [value for value in allowed if not isinstance(value, str)] or [-math.inf, math.inf]
        super().__init__(allowed.__contains__, ", ".join(map(str, allowed)), min(numbers), max(numbers))


class OffOrAtLeast(Rule):
    """Rule that allows 0, which has a meaning of its own, and numbers from a limit on."""

    def __init__(self, least: float, zero: str = "off", numbers: str = "a number") -> None:
        """Allow 0, whose meaning is `zero`, and numbers from `least` on; `numbers` describes these."""
        super().__init__(lambda value: value == 0 or value >= least, f"0 ({zero}) or {numbers} >= {least:g}", 0.0)


class Limits(NamedTuple):
    """Limits of a parameter."""

    least: float
    """Smallest number, itself allowed unless `words` say otherwise; -inf if there is none, or for a text"""
    most: float
    """Largest number, itself allowed unless `words` say otherwise; inf if there is none, or for a text"""
    words: str
    """Limits that the numbers do not show: a list, an open end, a gap; empty if there are none"""


def limits_of(field: FieldInfo) -> Limits:
    """Limits of a declared parameter, from the rules in its annotation."""
    least, most, words = -math.inf, math.inf, []
    for rule in field.metadata:
        if isinstance(rule, Rule):
            least, most = max(least, rule.least), min(most, rule.most)
            words.append(rule.words)
        least, most = getattr(rule, "ge", least), getattr(rule, "le", most)  # the rules of annotated_types
        if hasattr(rule, "gt"):
            least = rule.gt
            words.append(f"> {least:g}")
        if hasattr(rule, "lt"):
            most = rule.lt
            words.append(f"< {most:g}")
    return Limits(least, most, "; ".join(words))
