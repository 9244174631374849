# knee_contact_ros on ROS 2 Jazzy (Ubuntu 24.04), without Rerun: it needs NumPy 2, and Ubuntu's SciPy needs NumPy 1.
#   docker build --tag knee-contact .
#   docker run --rm --network host --ipc host knee-contact node --ros-args ...
FROM ros:jazzy-ros-base

ENV PIP_NO_CACHE_DIR=1 PYTHONDONTWRITEBYTECODE=1
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
WORKDIR /ws

# What package.xml declares, from Ubuntu and ROS.
COPY package.xml src/knee_contact_ros/package.xml
# The distribution's versions are what ROS is built with: none is pinned.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends python3-venv \
    && rosdep update --rosdistro "$ROS_DISTRO" \
    && rosdep install --from-paths src --ignore-src --default-yes \
        --dependency-types=buildtool --dependency-types=build --dependency-types=exec \
    && rm -rf /var/lib/apt/lists/*

# The rest, from PyPI, as docs/how-to/install.md says; NumPy stays Ubuntu's.
RUN python3 -m venv --system-site-packages venv \
    && venv/bin/pip install "numpy<2" "numba>=0.68,<0.69" "mcap>=1.6,<1.7" "rosbags>=0.11,<0.12" \
        "pydantic>=2.6,<3" "ruamel.yaml>=0.18,<1" "zstandard>=0.21,<1" "lz4>=4"
ENV VIRTUAL_ENV=/ws/venv PATH=/ws/venv/bin:$PATH

COPY . src/knee_contact_ros
RUN . "/opt/ros/$ROS_DISTRO/setup.bash" \
    && python3 -m colcon build --base-paths src --cmake-args -DBUILD_TESTING=OFF -DPython3_EXECUTABLE=/ws/venv/bin/python3 \
    && rm -rf build log

USER 1000
WORKDIR /home/ubuntu
STOPSIGNAL SIGINT
ENTRYPOINT ["/bin/bash", "-c", ". /ws/install/setup.bash && exec knee-contact \"$@\"", "knee-contact"]
CMD ["node"]
