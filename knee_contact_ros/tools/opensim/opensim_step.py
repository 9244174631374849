"""One tool of OpenSim in a process of its own, with TOOL SETUP, run in the folder of the set-up files.

It imports nothing of ours: OpenSim prints much, and can take its process with it.
"""

from __future__ import annotations

import sys


def main() -> int:
    """Run the tool; 1 if it says that it has failed."""
    import opensim

    tool = getattr(opensim, sys.argv[1])(sys.argv[2])
    return 0 if tool.run() else 1


if __name__ == "__main__":
    raise SystemExit(main())
