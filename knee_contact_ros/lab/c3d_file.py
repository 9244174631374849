"""C3D files in a process of its own: `INPUT OUTPUT PLATES` writes what is used of a file by `pickle`.

ezc3d trusts the sizes in a file, so a damaged one may end its process by a signal, or ask for any memory.
"""

import pickle
import struct
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

MEMORY, FACTOR = 2**30, 60
"""Memory [B] that a file may take, and how much more for each of its bytes: samples of 2 B become objects"""
LARGEST_FRAME = 65535
"""Last frame by the header of files that have as many frames or more"""
_USED = {"points", "analogs", "platform"}


def stated_frames(path: Path) -> int:
    """Return the number of frames by the header, of which a file that was cut off has fewer; 0: not known.

    ezc3d puts the number that it has read into the header. Other processors' numbers than Intel's are not read here.
    """
    with path.open("rb") as file:
        parameters, first, last = struct.unpack("<B5xHH", file.read(10))
        file.seek(512 * (parameters - 1) + 3)
        is_known = file.read(1) == b"\x54" and last < LARGEST_FRAME
    return last - first + 1 if is_known else 0


def main(path: str, output: str, plates: str) -> None:
    """Read a file, with its force plates if `plates` is not empty."""
    import ezc3d

    with suppress(ImportError):  # Windows has no limit
        import resource

        most = MEMORY + FACTOR * Path(path).stat().st_size
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    read: Any = ezc3d.c3d(path, extract_forceplat_data=bool(plates))
    data = {name: read["data"][name] for name in read["data"].keys() & _USED}
    content = {
        "header": {"points": read["header"]["points"]},
        "stated_frames": stated_frames(Path(path)),
        "parameters": dict(read["parameters"]),
        "data": data,
    }
    with Path(output).open("wb") as file:
        pickle.dump(content, file, pickle.HIGHEST_PROTOCOL)


if __name__ == "__main__":
    main(*sys.argv[1:])
