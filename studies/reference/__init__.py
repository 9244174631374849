"""A reference that shares no code with the model: its own laws, surface and integrator, in C with 64 bits of mantissa.

Explicit steps by power series of high order, whose events are zeros of polynomials; implicit ones (Radau, order 13)
where the contact is stiff or its force has no series. Every scene is solved twice: the difference bounds the error.
"""

from studies.reference.laws import LAWS, Law
from studies.reference.solver import Knee, Reference, Solution, solve

__all__ = ["LAWS", "Knee", "Law", "Reference", "Solution", "solve"]
