"""Has the compiler ready: its first function takes seconds, the next ones none."""

from __future__ import annotations

from numba import njit

from knee_contact_ros.compiled.functions import ENTRY

njit(**ENTRY)(lambda value: value + value)(1.0)
