"""Run a tool of OpenSim in a process of its own with the arguments TOOL SETUP, in the folder of the set-up file.

It imports nothing of ours: OpenSim prints much, and can end its process.
"""

from __future__ import annotations

import sys


def main() -> int:
    """Run the tool; return 1 if it reports that it has failed, else 0."""
    import opensim

    tool = getattr(opensim, sys.argv[1])(sys.argv[2])
    return 0 if tool.run() else 1


if __name__ == "__main__":
    raise SystemExit(main())
