"""Fixtures that several tests need."""

import os
import shutil
import signal
import subprocess
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import settings

from knee_contact_ros.model.kernel import library
from knee_contact_ros.system.files import share_folder
from tests import ROOT
from tests.helpers.browser import started_browser
from tests.helpers.needs import skipped_in_a_line
from tests.helpers.sinks import Started

os.environ.pop(
    "RMW_IMPLEMENTATION", None
)  # the tests have a graph of their own, with what is installed
settings.register_profile("no timed tests", deadline=None)
settings.load_profile("no timed tests")

WAITING, LONG = {"ros"}, {"packaging", "studies", "calibrate", "sweep", "benchmarks"}
NEXT = {"bags", "node", "view", "hostile"}
"""Folders with files that one process runs and that mostly wait; with tests of half a minute; with tests of seconds"""
NEED_ROS = [
    *("streams/test_load_pipeline.py", "streams/test_messages.py"),
    "offline/test_demo_sensors.py",
]
collect_ignore = [] if find_spec("rclpy") else NEED_ROS
LONGEST_NAME = 60
"""Largest length of a text, or of bytes, by which a case is named"""
REFERENCE_DATA = ROOT.parent / "shared" / "data"


def pytest_configure(config):
    """Know the mark of pytest-xdist also where that is not installed, and have Ctrl-C end what tests start.

    A shell lets what it starts in the background ignore SIGINT, and all that this starts.
    """
    config.addinivalue_line("markers", "xdist_group(name): tests that one process runs, in turn")
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_make_parametrize_id(val):
    """Name a case after the beginning of a long text: workers send each other the names of all."""
    return (
        ascii(val[:LONGEST_NAME])
        if isinstance(val, str | bytes) and len(val) > LONGEST_NAME
        else None
    )


def pytest_sessionstart(session):
    """Build the model, if it was edited, once and before all workers, whose tests would wait for it."""
    if not hasattr(session.config, "workerinput"):
        library()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Begin with what takes longest, those that wait among those that compute, so that no processor is idle."""

    def of(folders):
        return [
            item for item in items if not folders.isdisjoint(item.path.relative_to(ROOT).parts)
        ]

    waiting, long = of(WAITING), of(LONG)
    files = list(dict.fromkeys(item.path for item in waiting))
    place = {item: files.index(item.path) / len(files) for item in waiting}
    place |= {item: number / len(long) for number, item in enumerate(long)}
    place |= dict.fromkeys(of(NEXT), 1.0)
    items.sort(key=lambda item: place.get(item, 2.0))


def pytest_terminal_summary(terminalreporter):
    """Say in one line what was skipped, and how each of it is enabled."""
    skipped = terminalreporter.stats.get("skipped", [])
    if skipped:
        terminalreporter.write_line(skipped_in_a_line(each.longrepr for each in skipped))


@pytest.fixture(scope="session")
def config():
    """Folder of the shipped parameter files."""
    return share_folder() / "config"


@pytest.fixture(scope="session")
def right_bag():
    """The shipped gait of the right leg."""
    return share_folder() / "bags" / "gait2354_right"


@pytest.fixture(scope="session")
def sensors_bag():
    """What sensors of that leg tell, likewise."""
    return share_folder() / "bags" / "gait2354_right_sensors"


@pytest.fixture(scope="session")
def reference_data():
    """Answers of an independent solver and the tables that the bags were made from; not part of the project."""
    if not REFERENCE_DATA.is_dir():
        pytest.skip("the reference data are not on this machine")
    return REFERENCE_DATA


@pytest.fixture(scope="session")
def browser():
    """A browser without a screen (selenium's driver)."""
    with started_browser() as driver:
        yield driver


@pytest.fixture
def hidden_screen(tmp_path, monkeypatch):
    """A screen that nobody sees."""
    if not shutil.which("Xvfb"):
        pytest.skip("there is no Xvfb here; on Debian: apt install xvfb")
    read, write = os.pipe()
    command = ["Xvfb", "-displayfd", str(write), "-screen", "0", "1600x900x24", "-nolisten", "tcp"]
    server = subprocess.Popen(
        command, pass_fds=[write], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    os.close(write)
    try:
        number = os.read(read, 10).decode().strip()
        if not number:
            pytest.skip("Xvfb does not start here")
        monkeypatch.setenv("DISPLAY", f":{number}")
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
        yield
    finally:
        os.close(read)
        server.kill()
        server.wait()


@pytest.fixture
def hang_up():
    """Have SIGHUP end processes that are started, also where the tests run under `nohup`."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.fixture
def started():
    """No process may be left by a test that has closed its sinks."""
    started = Started()
    yield started
    left = [
        sink.process for sink in started.sinks if sink.process and sink.process.returncode is None
    ]
    for process in left:
        process.kill()
    assert left == []


@pytest.fixture(scope="session")
def old_recording():
    """The right gait bag with healthy.yaml, by `solve` as it was before sliding velocity and force error were told."""
    return Path(__file__).parent / "recordings" / "without_later_fields.mcap"


@pytest.fixture(scope="session")
def watching(tmp_path_factory):
    """A library that stands between a program and its disk: `watched_disk.c`."""
    return compiled("watched_disk", tmp_path_factory)


@pytest.fixture(scope="session")
def counted_allocations(tmp_path_factory):
    """A library that counts the interpreter's allocations: `counted_allocations.c`."""
    return compiled("counted_allocations", tmp_path_factory)


def compiled(name, tmp_path_factory):
    """Compile a library of this folder."""
    source = Path(__file__).with_name(f"{name}.c")
    path = tmp_path_factory.mktemp(name) / f"{name}.so"
    compiler = shutil.which("cc")
    if not compiler:
        pytest.skip("there is no C compiler here")
    subprocess.run(
        [compiler, "-shared", "-fPIC", "-O1", "-o", path, source, "-ldl", "-lpthread"], check=True
    )
    return path


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 1 MB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount, umount = shutil.which("mount"), shutil.which("umount")
    if os.geteuid() or not (mount and umount):
        pytest.skip("only root may mount a file system")
    command = [mount, "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"no file system can be mounted here: {done.stderr.strip()}")
    yield folder
    subprocess.run([umount, "--lazy", str(folder)], check=True)
