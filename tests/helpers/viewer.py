"""Rerun's viewer without a screen: what it shows of a file, as pictures."""

import io
import os
import signal
import subprocess
import sysconfig
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import numpy as np
import psutil
import pytest
from PIL import Image

pytest.importorskip("rerun", reason="needs the extra viewer")
from rerun.experimental import ViewerClient

from knee_contact_ros.system.processes import free_port
from tests.helpers.patience import patience

RERUN = Path(sysconfig.get_path("purelib")) / "rerun_cli" / "rerun"
LIFE = 300
"""[s] after which a viewer ends whatever becomes of the test"""
PAUSE = 0.1
NO_RENDERER = ("No graphics adapter was found", "Failed to get render context")
SOFTWARE = "Software rasterizer detected"
T = TypeVar("T")


class Screen:
    """What a viewer shows."""

    def __init__(self, client):
        self._client = client

    @property
    def state(self):
        """Recordings, timelines and views as the viewer reports them."""
        return self._client.get_state()

    def views(self):
        """The views by name."""
        return {view.name: view for view in self.state.views}

    def set_time(self, timeline, stamp):
        """Put the cursor on a stamp [ns] of a timeline and wait until it stands there."""
        self._client.set_time(timeline, duration=np.timedelta64(stamp, "ns"), play_state="paused")

        def cursor():
            state = self.state
            (shown,) = (
                item for item in state.recordings if item.store_id == state.active_recording
            )
            return (shown.current_timeline, shown.current_time) == (timeline, stamp)

        wait_for(cursor, f"the cursor to stand on {timeline} {stamp} ns")

    def picture(self, view=None):
        """The whole screen, or one view by its name, when it has come to rest; shape (height, width, 3)."""
        view_id = None if view is None else self.views()[view].view_id
        pictures = [self._shot(view_id)]

        def at_rest():
            pictures.append(self._shot(view_id))
            return np.array_equal(*pictures[-2:])

        wait_for(at_rest, "two pictures in a row to be the same")
        return pictures[-1]

    def complaints(self):
        """Warnings and errors: of the views about what they cannot show, and in the viewer's log."""
        reports = [
            f"{view.name}: {report.summary}"
            for view in self.state.views
            for report in view.reports
        ]
        logged = [entry for entry in self._client.get_logs() if entry.level in ("WARN", "ERROR")]
        return reports + [entry.message for entry in logged if SOFTWARE not in entry.message]

    def _shot(self, view_id):
        with Image.open(io.BytesIO(self._client.take_screenshot(view_id))) as image:
            return np.asarray(image.convert("RGB"))


@contextmanager
def rendered(*files, size=(1600, 900)):
    """A viewer of `size` pixels in which `rerun FILE ...` has loaded its files; skips where nothing can be drawn.

    It listens on this machine only, knows no settings of the user's, sends no statistics, and is gone afterwards.
    """
    with TemporaryDirectory() as home:
        environment = {**os.environ, "HOME": home, "XDG_CONFIG_HOME": home, "XDG_DATA_HOME": home}
        environment |= {
            "XDG_RUNTIME_DIR": home,
            "NO_COLOR": "1",
            "RUST_LOG": "warn,egui_wgpu=error,re_renderer=error",
        }
        subprocess.run(
            [RERUN, "analytics", "disable"], env=environment, capture_output=True, check=True
        )
        port, log = free_port(), Path(home) / "log"
        options = [
            "--headless",
            "--hide-welcome-screen",
            "--bind",
            "127.0.0.1",
            "--port",
            str(port),
        ]
        command = [
            "timeout",
            str(LIFE),
            RERUN,
            *options,
            "--window-size",
            "{}x{}".format(*size),
            *files,
        ]
        with log.open("wb") as output:
            viewer = subprocess.Popen(
                command, env=environment, stdout=output, stderr=output, start_new_session=True
            )
        try:
            yield Screen(loaded(viewer, port, log))
        except BaseException:
            print(log.read_text(errors="replace"))  # noqa: T201  (pytest shows it with what failed)
            raise
        finally:
            with suppress(ProcessLookupError):
                os.killpg(viewer.pid, signal.SIGKILL)
            viewer.wait()


def loaded(viewer, port, log):
    """Connect, and wait until the files are loaded and there are views."""

    def look():
        if viewer.poll() is not None:
            said = log.read_text(errors="replace")
            if any(reason in said for reason in NO_RENDERER):
                pytest.skip(
                    "Rerun cannot draw here; on Debian: apt install mesa-vulkan-drivers libgl1-mesa-dri"
                )
            pytest.fail(f"the viewer ended with {viewer.returncode}:\n{said}")
        with suppress(Exception):  # nobody answers yet; the library raises what it likes
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            state = client.get_state()
            ready = state.views and state.active_recording and not state.loading
            return client if ready and all(item.timelines for item in state.recordings) else None
        return None

    return wait_for(look, "the viewer to load its files")


def wait_for(condition, what):
    """What `condition` gives as soon as it is true."""
    begin = time.monotonic()
    while time.monotonic() < begin + patience():
        if found := condition():
            return found
        time.sleep(PAUSE)
    pytest.fail(f"waited in vain for {what}")


def shown_to(state):
    """The newest stamp [ns] that a viewer has."""
    return max(
        (line.end for recording in state.recordings for line in recording.timelines), default=-1
    )


@contextmanager
def window_of(process, newest):
    """The viewer that a process has opened, once it has this stamp [ns]; it is gone afterwards."""

    def started():
        return next(
            (child for child in process.children(recursive=True) if child.name() == "rerun"), None
        )

    viewer = wait_for(started, "the viewer to start")

    def shows():
        places = [
            one.laddr for one in viewer.net_connections("tcp") if one.status == psutil.CONN_LISTEN
        ]
        with suppress(IndexError, RuntimeError, ConnectionError, TimeoutError, ValueError):
            address = f"rerun+http://{places[0].ip}:{places[0].port}/proxy"
            return shown_to(ViewerClient.connect(address).get_state()) >= newest
        return False

    try:
        wait_for(shows, "the window to have all")
        yield viewer
    finally:
        with suppress(psutil.NoSuchProcess):
            viewer.kill()


def pixels_of(picture, colour, within=12):
    """How many pixels have a colour, to `within` in each of red, green and blue (edges of lines are blended)."""
    return int((np.abs(picture.astype(int) - colour) <= within).all(axis=2).sum())
