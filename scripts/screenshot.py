#!/usr/bin/env python3
"""Render a scene to a picture without a screen: `screenshot.py FILE.rrd OUT.png [SECONDS]`.

SECONDS sets the time cursor on the stamp timeline, where live stamps are seconds since 1970; in place of a file, the
address that a node serves on. The picture has 256 colours, which halves it. On Debian this needs mesa-vulkan-drivers
and libgl1-mesa-dri.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from PIL import Image

from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.view.layout import TIMELINE
from tests.helpers.viewer import rendered


def main() -> int:
    """Render the picture."""
    if len(sys.argv) < 3:
        raise SystemExit(__doc__)
    scene, picture, *seconds = sys.argv[1:]
    with rendered(scene) as screen:
        if seconds:
            screen.set_time(TIMELINE, round(float(seconds[0]) * NANOSECONDS))
        Image.fromarray(screen.picture()).quantize(256, dither=Image.Dither.NONE).save(
            Path(picture), optimize=True
        )
        for complaint in screen.complaints():
            print(complaint)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
