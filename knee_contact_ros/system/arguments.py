"""Arguments of public functions: one of another kind ends in one line that names it, before a library sees it."""

import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from inspect import signature
from numbers import Integral, Real
from os import PathLike
from typing import Any, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

from .errors import UsageError

P = ParamSpec("P")
T = TypeVar("T")
EXAMPLES = {"values": "{'contact.damping': 0.0}", "remap": "{'joint_states': '/exo/joint_states'}"}
"""Examples of arguments, by their names"""
_KINDS: dict[Any, tuple[type, str]] = {
    float: (Real, "a number"),
    int: (Integral, "a whole number"),
    str: (str, "a text"),
    PathLike: (PathLike, "a path"),
    Mapping: (Mapping, "a mapping"),
    Sequence: (Sequence, "a list"),
    Iterable: (Iterable, "a list"),
    types.NoneType: (types.NoneType, "None"),
}
"""Classes, and words, by what a type hint says; an argument with another hint is not checked"""


def checked(function: Callable[P, T]) -> Callable[P, T]:
    """Make a function refuse arguments that are not of the kinds of its type hints.

    Raises:
        UsageError: when it is called so.
    """
    kinds = {}
    for name, hint in get_type_hints(function).items():
        parts = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
        found = [_KINDS.get(get_origin(part) or part) for part in parts]
        if all(found) and name != "return":
            kinds[name] = dict(filter(None, found))
    bind = signature(function).bind

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        for name, value in bind(*args, **kwargs).arguments.items():
            allowed = kinds.get(name)
            if allowed and not isinstance(value, tuple(allowed)):
                what = " ".join(repr(value).split())
                what = what if len(what) < 60 else f"{what[:60]}..."
                words = ", or ".join(allowed.values())
                words = f"a mapping, as {EXAMPLES[name]}" if name in EXAMPLES else words
                raise UsageError(f"{name}: {what} is not allowed; {words}")
        return function(*args, **kwargs)

    return call
