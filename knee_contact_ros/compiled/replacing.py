"""`_replace` of named tuples in compiled code, which Numba does not have: imported, it is there."""

from __future__ import annotations

import inspect
from typing import Any

from numba import types
from numba.core.imputils import impl_ret_borrowed
from numba.core.typing.templates import AttributeTemplate, Signature, bound_function, infer_getattr, signature
from numba.extending import lower_builtin

REPLACE = "namedtuple._replace"
KEYWORD = inspect.Parameter.POSITIONAL_OR_KEYWORD


@infer_getattr
class _Replace(AttributeTemplate):
    """Types of a call: every field is an argument of its own type, or of none if the field keeps its value."""

    key = types.BaseNamedTuple

    @bound_function(REPLACE)
    def resolve__replace(self, kind: Any, arguments: tuple[Any, ...], keywords: dict[str, Any]) -> Signature | None:
        if arguments or not set(keywords) <= set(kind.fields):
            return None
        given = [of if name in keywords else types.none for name, of in zip(kind.fields, kind.types, strict=True)]
        parameters = [inspect.Parameter(name, KEYWORD, default=None) for name in kind.fields]
        return signature(kind, *given).replace(pysig=inspect.Signature(parameters))


@lower_builtin(REPLACE, types.BaseNamedTuple, types.VarArg(types.Any))
def _replace(context: Any, builder: Any, signature: Signature, arguments: tuple[Any, ...]) -> Any:
    """Put the given values into the named tuple's value."""
    changed, *values = arguments
    for index, (kind, value) in enumerate(zip(signature.args[1:], values, strict=True)):
        if kind is not types.none:
            changed = builder.insert_value(changed, value, index)
    return impl_ret_borrowed(context, builder, signature.return_type, changed)
