"""Coefficients of the Radau IIA method of the reference, to 30 digits: `radau_table.h` is this module's output.

python -m studies.reference.radau_coefficients > studies/reference/radau_table.h
"""

from __future__ import annotations

import math
from decimal import Decimal, localcontext

import click

STAGES = 7
"""Order 13 for smooth solutions"""
DIGITS = 30
Matrix = list[list[Decimal]]


def nodes(stages: int) -> list[Decimal]:
    """Zeros of the (s-1)-th derivative of x^(s-1) (x-1)^s, the last of which is 1."""
    # x^(s-1) (x-1)^s has integer coefficients, and so has its derivative
    polynomial = [
        Decimal(
            math.comb(stages, k) * (-1) ** (stages - k) * math.perm(k + stages - 1, stages - 1)
        )
        for k in range(stages + 1)
    ]

    def value(x: Decimal) -> Decimal:
        total = Decimal(0)
        for coefficient in reversed(polynomial):
            total = total * x + coefficient
        return total

    found, cells = [], 4096
    for cell in range(cells - 1):  # the zero at 1 is known
        low, high = (
            (Decimal(cell) + Decimal("0.5")) / cells,
            (Decimal(cell) + Decimal("1.5")) / cells,
        )
        if high < 1 and value(low) * value(high) < 0:
            for _ in range(200):
                middle = (low + high) / 2
                low, high = (low, middle) if value(low) * value(middle) <= 0 else (middle, high)
            found.append((low + high) / 2)
    return [*found, Decimal(1)]


def solved(matrix: Matrix, right: Matrix) -> Matrix:
    """Solve `matrix` X = `right` by elimination with pivots."""
    n = len(matrix)
    rows = [[*matrix[i], *right[i]] for i in range(n)]
    for i in range(n):
        pivot = max(range(i, n), key=lambda row: abs(rows[row][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for row in range(n):
            if row != i:
                factor = rows[row][i]
                rows[row] = [x - factor * y for x, y in zip(rows[row], rows[i], strict=True)]
    return [row[n:] for row in rows]


def table(stages: int) -> tuple[list[Decimal], Matrix, Matrix]:
    """Nodes c, matrix A and its inverse: the stages integrate polynomials of degree s-1 exactly."""
    with localcontext() as context:
        context.prec = 80
        c = nodes(stages)
        # sum_j a_ij c_j^k = c_i^(k+1) / (k+1), solved for the rows of A
        powers = [[node**k if k else Decimal(1) for node in c] for k in range(stages)]
        integrals = [[node ** (k + 1) / (k + 1) for node in c] for k in range(stages)]
        transposed = solved(powers, integrals)
        a = [[transposed[j][i] for j in range(stages)] for i in range(stages)]
        unit = [[Decimal(int(i == j)) for j in range(stages)] for i in range(stages)]
        return c, a, solved(a, unit)


def header(stages: int = STAGES) -> str:
    """The C header."""
    c, a, inverse = table(stages)

    def row(values: list[Decimal]) -> str:
        return "{" + ", ".join(f"{value:.{DIGITS}e}L" for value in values) + "}"

    def matrix(name: str, rows: Matrix) -> str:
        body = ",\n    ".join(row(values) for values in rows)
        return f"static const real {name}[STAGES][STAGES] = {{\n    {body}}};"

    return "\n".join(
        [
            "/* Radau IIA: made by python -m studies.reference.radau_coefficients */",
            f"#define STAGES {stages}",
            f"static const real NODES[STAGES] = {row(c)};",
            matrix("RADAU", a),
            matrix("RADAU_INVERSE", inverse),
        ]
    )


if __name__ == "__main__":
    click.echo(header())
