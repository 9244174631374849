"""Source distribution and wheel, as a user gets them: `make test-package`.

Built from the files that git knows (those not yet added too), the wheels from the source distribution: one without ROS,
and one with the messages. Each is installed into a new environment outside the tree. It takes two minutes and
downloads what is not in uv's cache, so `make test` leaves it out.
"""

import os
import re
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path
from typing import NamedTuple
from zipfile import ZipFile

import pytest

from knee_contact_ros import __version__
from tests import ROOT
from tests.packaging.test_printed_commands import NEED, SAVED, blocks_of

PACKAGE = "knee_contact_ros"
UV = Path(sys.prefix) / "bin" / "uv"
NOT_SHIPPED = ("tests", ".github", ".ci", ".gitignore", "MANIFEST.in")
SHARED = ("bags", "config", "examples", "launch", "urdf")
OF_THIS_ENVIRONMENT = (
    "VIRTUAL_ENV",
    "PYTHONPATH",
    "AMENT_PREFIX_PATH",
    "CMAKE_PREFIX_PATH",
    "LD_LIBRARY_PATH",
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",  # the ROS wheels set these in every process that imports one
)
PATIENCE = 600
"""[s]"""


class Distributions(NamedTuple):
    """What is built."""

    files: set[str]
    """Those it is built from, relative to the tree"""
    source: Path
    wheel: Path
    """For any Python 3, without ROS"""
    with_messages: Path


def run(*command, folder):
    """What a command prints; it knows nothing of this environment, and must end well."""
    environment = {
        name: value for name, value in os.environ.items() if name not in OF_THIS_ENVIRONMENT
    }
    done = subprocess.run(
        command,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def distributions(tmp_path_factory):
    """Built from a clean copy of the tree."""
    if not UV.exists() or not shutil.which("git") or not (ROOT / ".git").exists():
        pytest.skip("needs uv beside Python, git, and the tree under git")
    folder = tmp_path_factory.mktemp("distributions")
    listed = run(
        "git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", folder=ROOT
    )
    files = {name for name in listed.split("\0") if name and (ROOT / name).is_file()}
    for name in files:
        copy = folder / "tree" / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, copy)
    run(UV, "build", "--quiet", "--sdist", "--out-dir", folder, "tree", folder=folder)
    (source,) = folder.glob("*.tar.gz")
    options = "--quiet", "--wheel", "--python", sys.executable, source
    for name, more in (("plain", []), ("messages", ["--config-settings", "messages=yes"])):
        run(UV, "build", *options, "--out-dir", folder / name, *more, folder=folder)
    wheels = [next((folder / name).glob("*.whl")) for name in ("plain", "messages")]
    return Distributions(files, source, *wheels)


def environment_with(wheel, folder):
    """Return the programs of a new environment that has a wheel and what it asks for, and nothing else."""
    run(UV, "venv", "--quiet", "--python", sys.executable, "venv", folder=folder)
    programs = folder / "venv" / "bin"
    options = "--quiet", "--python", programs / "python"
    run(UV, "pip", "install", *options, wheel, folder=folder)
    return programs


@pytest.fixture(scope="module")
def plain(distributions, tmp_path_factory):
    """An environment without ROS."""
    return environment_with(str(distributions.wheel), tmp_path_factory.mktemp("plain"))


@pytest.fixture(scope="module")
def installed(distributions, tmp_path_factory):
    """An environment with ROS from PyPI."""
    folder = tmp_path_factory.mktemp("installed")
    return environment_with(f"{distributions.with_messages}[ros]", folder)


def test_the_source_distribution_has_what_git_has(distributions):
    with tarfile.open(distributions.source) as archive:
        packed = {
            member.name.partition("/")[2] for member in archive.getmembers() if member.isfile()
        }
    wanted = {name for name in distributions.files if name.split("/")[0] not in NOT_SHIPPED}
    assert wanted - packed == set()
    assert not [name for name in packed if name.startswith("tests/") or "__pycache__" in name]


def test_the_wheel_has_modules_messages_and_shared_files_and_nothing_else(
    distributions,
):
    with ZipFile(distributions.with_messages) as archive:
        packed = set(archive.namelist())
    data = f"{PACKAGE}-{__version__}.data/data/"
    ours = {name for name in distributions.files if name.startswith(f"{PACKAGE}/")}
    shared = {
        f"{data}share/{PACKAGE}/{name}"
        for name in distributions.files
        if name.split("/")[0] in SHARED
    }
    message = {
        f"{data}share/{PACKAGE}/{name}"
        for name in ("package.xml", "msg/KneeContact.msg", "msg/KneeContact.idl")
    }
    modules = {name for name in packed if name.startswith(f"{PACKAGE}/")}
    (library,) = modules - ours
    assert re.fullmatch(rf"{PACKAGE}/model/knee_contact-[0-9a-f]{{16}}\.so", library)
    assert ours <= modules
    assert f"{PACKAGE}/py.typed" in ours
    assert (shared | message) - packed == set()
    tops = tuple(
        f"{data}{top}"
        for top in (
            f"share/{PACKAGE}/",
            "share/ament_index/",
            f"lib/{PACKAGE}/",
            f"lib/lib{PACKAGE}__",
            "lib/libtf2_msgs__",
            "share/tf2_msgs/",
            "lib/python",
        )
    )
    others = {
        name
        for name in packed - modules
        if not name.startswith((*tops, f"{PACKAGE}-{__version__}.dist-info/"))
    }
    assert others == set()


def test_the_wheel_without_messages_is_for_any_python_and_asks_for_no_ros(
    distributions,
):
    assert "-py3-none-linux_" in distributions.wheel.name
    with ZipFile(distributions.wheel) as archive:
        names = archive.namelist()
        (metadata,) = (name for name in names if name.endswith("METADATA"))
        asked = re.findall(r"Requires-Dist: (.*)", archive.read(metadata).decode())
    assert [one for one in asked if one.startswith("ros-") and "extra ==" not in one] == []
    assert [one for one in asked if one.startswith("ros-jazzy-rclpy")] != []
    data = f"{PACKAGE}-{__version__}.data/data/share/{PACKAGE}/"
    shared = {f"{data}{one}" for one in distributions.files if one.split("/")[0] in SHARED}
    assert shared <= set(names)
    compiled = [name for name in names if name.endswith(".so")]
    assert [name.split("/")[1] for name in compiled] == ["model"]
    assert not [name for name in names if "/lib/" in name or name.startswith(f"{PACKAGE}/msg")]


def test_the_wheel_without_messages_runs_without_ros(plain, tmp_path):
    listed = run(UV, "pip", "list", "--python", plain / "python", folder=tmp_path)
    assert not re.search("^(ros-|rclpy|numba|llvmlite)", listed, re.MULTILINE)
    bag = plain.parent / "share" / PACKAGE / "bags" / "gait2354_right"
    solved = run(plain / "knee-contact", "solve", bag, "--output", "solved.mcap", folder=tmp_path)
    assert "1613.8" in solved  # the largest load of the gait [N]
    done = subprocess.run(
        [plain / "knee-contact", "demo"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.startswith("knee-contact: this command needs ROS 2: ")


@pytest.mark.parametrize(
    ("page", "extras"), [("your-subject", "mesh,report"), ("notebook", "notebook")]
)
def test_a_tutorial_that_needs_no_ros_runs_beside_the_wheel(page, extras, distributions, tmp_path):
    """To the letter, in the folder of the sources, by the library that was installed."""
    programs = environment_with(f"{distributions.wheel}[{extras}]", tmp_path)
    sources = tmp_path / "sources"
    shutil.copytree(distributions.source.parent / "tree", sources)
    shell, python, shown = f"exec 2>&1; export MPLBACKEND=Agg PATH={programs}:$PATH\n", "", ""
    for before, kind, text in blocks_of(f"docs/tutorials/{page}.md"):
        if "This step needs" in before:  # ROS
            break
        if saved := SAVED.search(before):
            (sources / saved[1]).write_text(text, encoding="utf-8")
        elif kind == "sh" and not NEED.search(before):
            shell += text
        elif kind == "python":
            python += text
        elif kind == "text":
            shown += text
    (sources / "page.py").write_text(python, encoding="utf-8")
    printed = run("bash", "-ec", f"{shell}python page.py", folder=sources)
    assert "no compiled model" not in printed
    lines = [line.rstrip() for line in printed.splitlines()]
    for line in shown.splitlines():
        assert any(each.startswith(line.rstrip()) for each in lines), (
            f"{line!r} is not in\n{printed}"
        )


def test_package_indexes_take_all(distributions):
    told = run(sys.executable, "-m", "twine", "check", "--strict", *distributions[1:], folder=ROOT)
    assert told.count("PASSED") == 3


def test_the_command_tells_its_version_and_help(installed):
    assert (
        run(installed / "knee-contact", "--version", folder=installed)
        == f"knee-contact {__version__}\n"
    )
    assert "Usage: knee-contact" in run(installed / "knee-contact", "--help", folder=installed)


def test_python_finds_model_message_and_files(installed):
    code = """
import knee_contact_ros
from knee_contact_ros.msg import KneeContact
from knee_contact_ros.system.files import share_folder

model = knee_contact_ros.load_model(share_folder() / "config" / "osteoarthritis.yaml")
series = model.run([0.0, 0.01], [0.1, 0.1], [500.0, 600.0])
assert (series.penetration_depth > 0.0).all(), series
print(knee_contact_ros.__file__, share_folder(), KneeContact().status, sep="\\n")
"""
    module, share, status = run(installed / "python", "-c", code, folder=installed).split()
    assert Path(module).is_relative_to(installed.parent)
    assert Path(share).is_relative_to(installed.parent)
    assert status == "0"


def test_a_bag_is_solved_to_the_same_bytes(installed, tmp_path):
    bag = installed.parent / "share" / PACKAGE / "bags" / "gait2354_right"
    recordings = []
    for name, programs in (("installed", installed), ("tree", UV.parent)):
        (tmp_path / name).mkdir()
        recordings.append(tmp_path / name / "solved.mcap")
        run(programs / "knee-contact", "solve", bag, "--output", recordings[-1], folder=tmp_path)
    assert recordings[0].read_bytes() == recordings[1].read_bytes()


def test_the_node_runs(installed, tmp_path):
    """Without the extra `viewer`: it records, and says that it has not drawn."""
    told = run(installed / "knee-contact", "demo", "--output", "demo", folder=tmp_path)
    assert "1613.8" in told  # the largest load of the gait [N]
    assert "Not drawn" in told
    assert list((tmp_path / "demo").rglob("*.mcap"))
