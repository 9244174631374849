#!/usr/bin/env python3
"""Render a Rerun recording to a picture without a screen: `screenshot.py FILE.rrd OUT.png [SECONDS]`.

SECONDS sets the time cursor on the stamp timeline. On Debian this needs mesa-vulkan-drivers and libgl1-mesa-dri.
"""

from __future__ import annotations

import sys
import sysconfig
import time
from pathlib import Path

from rerun.experimental import ViewerClient

from knee_contact_ros.view.scene import TIMELINE

LOADING = 6.0
"""Time [s] that the viewer gets to load and draw."""


def main() -> int:
    """Render."""
    recording, picture = (Path(argument).resolve() for argument in sys.argv[1:3])
    viewer = ViewerClient.spawn(
        headless=True, port=19876, executable_path=f"{sysconfig.get_path('purelib')}/rerun_cli/rerun"
    )
    viewer.open([str(recording)])
    time.sleep(LOADING)
    if len(sys.argv) > 3:
        viewer.set_time(TIMELINE, duration=float(sys.argv[3]), play_state="paused")
        time.sleep(LOADING / 3)
    viewer.save_screenshot(str(picture))
    viewer.quit()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
