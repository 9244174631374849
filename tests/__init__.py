"""The tests; rooms as in the package, beside `ros` (a real node), `hostile` (commands and bad input) and `studies`."""

import os
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Before NumPy is loaded: there is a worker for every core, and threads of small matrices wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
