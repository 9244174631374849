"""The pip side of the package, and its build backend.

A build makes the compiled model, if it can. Where ROS's generators of messages are importable, as in the environment of
`make demo`, it also builds the messages, with the CMakeLists.txt that colcon uses; a wheel without them needs no ROS.
pip and uv build in an environment of their own: `--config-settings messages=yes` brings the generators there, and
`library=no` leaves out what the compiled model needs.

`build_ext` builds; `install_data` packs what belongs beside the Python modules: the package's files (`share/`) and of
the messages the libraries, what `ros2 run` starts (`lib/`) and their modules. An editable install takes the same way,
so the source tree holds no generated file but the compiled model.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from setuptools import Distribution, build_meta, setup
from setuptools.build_meta import *  # noqa: F403  (the rest of the backend)
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext
from setuptools.command.build_py import build_py
from setuptools.errors import SetupError

# isort: split
from distutils.command.install_data import install_data  # setuptools provides it

PACKAGE = "knee_contact_ros"
ROOT = Path(__file__).parent.resolve()
SHARED = ("bags", "config", "examples", "launch", "msg", "urdf", "package.xml")
"""What an installation has besides modules; CMakeLists.txt names the same"""
FOR_MODEL = ["numba>=0.68,<0.69", "numpy", "scipy>=1.11,<2"]
"""What the compiled model is built with, besides a C compiler"""
NO_NUMBA = ("Darwin", "x86_64")
"""System and processor for which Numba has no wheels"""
TOOLS = ["cmake>=3.20", "ninja", "empy", "catkin-pkg"]
GENERATORS = [
    f"ros-jazzy-{name}"
    for name in (
        "ament-cmake",
        "ament-cmake-gmock",
        "ament-cmake-gtest",
        "ament-cmake-include-directories",
        "ament-cmake-pytest",
        "ament-cmake-ros",
        "ament-package",
        "fastrtps-cmake-module",
        "geometry-msgs",
        "python-cmake-module",
        "rmw-fastrtps-cpp",
        "rosidl-core-generators",
        "rosidl-default-generators",
        "std-msgs",
    )
]
"""What the messages are built with"""


def get_requires_for_build_wheel(settings: dict[str, Any] | None = None) -> list[str]:
    """Return what a build needs that pyproject.toml does not name, as the standard of build backends has it."""
    given = settings or {}
    needed: list[str] = []
    machine = platform.system(), platform.machine()
    has_numba = machine[1] in {"x86_64", "AMD64", "aarch64", "arm64"} and machine != NO_NUMBA
    if given.get("library") != "no" and has_numba and sys.version_info < (3, 15):
        needed += FOR_MODEL
        if not any(map(shutil.which, ("cc", "gcc", "clang"))):
            needed.append("ziglang>=0.13")
    if given.get("messages") == "yes":
        needed += TOOLS + GENERATORS
    return needed


def get_requires_for_build_editable(settings: dict[str, Any] | None = None) -> list[str]:
    """The same for an editable install; in a tree whose own environment has ROS, it stays one with messages."""
    if list(ROOT.glob(".venv/lib/python*/site-packages/rclpy")):
        settings = {"messages": "yes", **(settings or {})}
    return get_requires_for_build_wheel(settings)


def build_wheel(
    folder: str, settings: dict[str, Any] | None = None, metadata: str | None = None
) -> str:
    """Build a wheel, and none without messages if they are asked for.

    Raises:
        SetupError: they cannot be built here.
    """
    if (settings or {}).get("messages") == "yes" and not ros_prefix():
        raise SetupError("messages=yes: the ROS 2 message generators are not importable here")
    name: str = build_meta.build_wheel(folder, settings, metadata)
    return name


def ros_prefix() -> Path | None:
    """Return the environment of ROS's generators: a virtual one, or that of an isolated build; None without them."""
    spec = find_spec("rosidl_adapter")
    if spec is None or spec.origin is None:
        return None
    prefix = Path(spec.origin).parents[4]
    packages = (prefix / "share" / name for name in ("ament_cmake", "rosidl_default_generators"))
    whole = all(map(shutil.which, ("cmake", "ninja"))) and all(
        map(find_spec, ("catkin_pkg", "em"))
    )
    return prefix if whole and all(map(Path.is_dir, packages)) else None


class CopyModules(build_py):
    """Copy the modules to where nothing of an earlier build is left, such as a library of another model."""

    def run(self) -> None:
        if not self.editable_mode:
            shutil.rmtree(self.build_lib, ignore_errors=True)
        super().run()


class BuildParts(build_ext):
    """Build the messages, into a staging folder, and the model."""

    @property
    def stage(self) -> Path:
        return Path(self.build_temp).resolve() / "stage"

    def run(self) -> None:
        shutil.rmtree(self.stage, ignore_errors=True)
        if prefix := ros_prefix():
            self.build_messages(str(prefix))
        if find_spec("numba"):
            self.build_model()

    def build_messages(self, prefix: str) -> None:
        """Run CMake: configure, build, install."""
        build_folder = Path(self.build_temp).resolve() / "cmake"
        build_folder.mkdir(parents=True, exist_ok=True)
        environment = {**os.environ, "AMENT_PREFIX_PATH": prefix, "CMAKE_PREFIX_PATH": prefix}
        for arguments in (
            [
                "-G",
                "Ninja",
                "-S",
                str(ROOT),
                "-B",
                str(build_folder),
                "-DBUILD_TESTING=OFF",
                "-DBUILD_LIBRARY=OFF",
                f"-DCMAKE_INSTALL_PREFIX={self.stage}",
                f"-DPython3_EXECUTABLE={sys.executable}",
            ],
            ["--build", str(build_folder)],
            ["--install", str(build_folder)],
        ):
            subprocess.run(["cmake", *arguments], env=environment, check=True)  # noqa: S607

    def build_model(self) -> None:
        """Build the library of the model beside its modules; without it the first use tries to build it."""
        model = Path(ROOT if self.editable_mode else self.build_lib, PACKAGE, "model").resolve()
        code = f"from knee_contact_ros.model.kernel import build_in; build_in({str(model)!r})"
        if subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode:
            print("The library of the model could not be built; its first use tries again.")  # noqa: T201


class InstallFiles(install_data):
    """Pack the package's files, and of the messages what was staged, into the wheel's data folder."""

    def run(self) -> None:
        if ros_prefix():
            stage = self.get_finalized_command("build_ext").stage
            (modules,) = stage.glob(f"lib*/python*/*-packages/{PACKAGE}")
            self.pack(
                stage,
                Path(),
                *stage.glob("lib/*.so"),
                *stage.glob(f"lib/{PACKAGE}/*"),
                *modules.glob("*.so"),
                *modules.glob("msg/*.py"),
                *modules.parent.glob("tf2_msgs/**/*"),
                *stage.glob("share/**/*"),
            )
        else:
            for name in SHARED:
                self.pack(ROOT, Path("share", PACKAGE), ROOT / name, *ROOT.glob(f"{name}/**/*"))

    def pack(self, source: Path, place: Path, *parts: Path) -> None:
        """Copy the files among some parts of a folder to a place in the data folder."""
        for part in parts:
            if part.is_file() and part.suffix != ".pyc":
                target = Path(self.install_dir) / place / part.relative_to(source)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(part, target)
                self.outfiles.append(str(target))


class NamedWheel(bdist_wheel):
    """A wheel for the Python that its messages are built for, else for any; without a library, for any machine."""

    def get_tag(self) -> tuple[str, str, str]:
        own: tuple[str, str, str] = super().get_tag()
        if ros_prefix():
            return own
        model = Path(self.get_finalized_command("build_py").build_lib, PACKAGE, "model")
        return "py3", "none", own[2] if list(model.glob("knee_contact-*")) else "any"


class OwnDistribution(Distribution):
    """A distribution with data, and compiled parts if they can be built, although neither is listed by name."""

    def has_ext_modules(self) -> bool:
        return bool(ros_prefix() or find_spec("numba"))

    def has_data_files(self) -> bool:
        return True

    has_data = has_data_files  # asked by editable installs


if __name__ == "__main__":
    setup(
        distclass=OwnDistribution,
        ext_modules=[],
        cmdclass={
            "build_py": CopyModules,
            "build_ext": BuildParts,
            "install_data": InstallFiles,
            "bdist_wheel": NamedWheel,
        },
    )
