"""Files that rosbag2 has compressed as a whole: what they hold is counted before anybody unpacks them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import zstandard

from knee_contact_ros.bags.recovery.scan import LITTLE, MOST_GROWTH
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.regular_file import open_regular

BLOCK = 2**20
"""[B]"""


def check_compressed(paths: Sequence[Path]) -> None:
    """Go through files and refuse those that hold too much for their size.

    Raises:
        UsageError: one does, or cannot be read.
    """
    for path in paths:
        try:
            with open_regular(path) as file:
                most = max(MOST_GROWTH * path.stat().st_size, LITTLE)
                reader = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
                while most >= 0 and (data := reader.read(BLOCK)):
                    most -= len(data)
        except (OSError, zstandard.ZstdError) as error:
            raise UsageError(f"cannot read bag file {path}: {error}") from None
        if most < 0:
            raise UsageError(f"{path} holds more than {MOST_GROWTH} times its size: no recording is compressed so well")
