"""The tests; rooms as in the package, beside `ros` (a real node), `hostile` (commands and bad input) and `studies`."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
