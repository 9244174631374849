"""The pip side of the package: builds the ROS messages, with the CMakeLists.txt that colcon uses, and the model.

`build_ext` configures, builds and installs the CMake project into a staging folder; `install_data` packs what belongs
beside the Python modules: the message libraries and what `ros2 run` starts (`lib/`), the generated message modules
(`site-packages/`) and the ament resources (`share/`). An editable install takes the same way, so the source tree holds
no generated file.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.build_ext import build_ext
from setuptools.errors import SetupError

# isort: split
from distutils.command.install_data import install_data  # setuptools provides it

PACKAGE = "knee_contact_ros"
ROOT = Path(__file__).parent.resolve()


def ros_prefix() -> Path:
    """The environment that holds the ROS 2 packages: a virtual environment, or pip's isolated build folder."""
    spec = importlib.util.find_spec("rosidl_adapter")
    if spec is None or spec.origin is None:
        raise SetupError(
            "rosidl_adapter is not importable: the ROS 2 message generators are missing from this build environment"
        )
    return Path(spec.origin).parents[4]


class BuildMessages(build_ext):
    """Run CMake: configure, build, install into a staging folder."""

    @property
    def stage(self) -> Path:
        return Path(self.build_temp).resolve() / "stage"

    def run(self) -> None:
        build_folder = Path(self.build_temp).resolve() / "cmake"
        shutil.rmtree(self.stage, ignore_errors=True)
        build_folder.mkdir(parents=True, exist_ok=True)
        prefix = str(ros_prefix())
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
        self.build_model()

    def build_model(self) -> None:
        """Build the library of the model beside its modules; without it the first use builds it."""
        model = Path(ROOT if self.editable_mode else self.build_lib, PACKAGE, "model").resolve()
        code = f"from knee_contact_ros.model.kernel import build_in; build_in({str(model)!r})"
        if subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode:
            print("The library of the model could not be built; its first use tries again.")  # noqa: T201


class InstallMessages(install_data):
    """Pack the staged message parts, resources and what `ros2 run` starts into the wheel's data folder."""

    def run(self) -> None:
        stage = self.get_finalized_command("build_ext").stage
        (modules,) = stage.glob(f"lib*/python*/*-packages/{PACKAGE}")
        parts = [
            *stage.glob("lib/*.so"),
            *stage.glob(f"lib/{PACKAGE}/*"),
            *modules.glob("*.so"),
            *modules.glob("msg/*.py"),
            *modules.parent.glob("tf2_msgs/**/*.py"),
            *modules.parent.glob("tf2_msgs/*.so"),
            *(path for path in stage.glob("share/**/*") if path.is_file()),
        ]
        for part in parts:
            target = Path(self.install_dir) / part.relative_to(stage)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(part, target)
            self.outfiles.append(str(target))


class RosDistribution(Distribution):
    """A distribution with compiled parts and data, although neither is listed by name."""

    def has_ext_modules(self) -> bool:
        return True

    def has_data_files(self) -> bool:
        return True

    has_data = has_data_files  # asked by editable installs


setup(
    distclass=RosDistribution,
    ext_modules=[],
    cmdclass={"build_ext": BuildMessages, "install_data": InstallMessages},
)
