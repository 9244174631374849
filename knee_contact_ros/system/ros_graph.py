"""Joins a ROS graph, or a private one: on loopback only, in a domain that no other run uses."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from domain_coordinator import domain_id

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.resources import share_folder


@contextmanager
def joining() -> Iterator[None]:
    """Turn errors of rclpy within the `with` block, such as missing security files, into one line.

    Raises:
        UsageError: the ROS graph cannot be joined.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # rclpy's, on what it could not clean up after the failure
        try:
            yield
        except RuntimeError as error:  # rclpy's own errors derive from it
            raise UsageError(f"cannot join the ROS graph: {error}") from None


@contextmanager
def private_graph() -> Iterator[dict[str, str]]:
    """Environment variables for processes that communicate with each other and with no others, here or elsewhere.

    `ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST` alone still opens sockets on every interface with Fast DDS; the profile in
    `config/fastdds_loopback.xml` binds them all to 127.0.0.1.
    """
    with domain_id() as domain:
        yield {"ROS_DOMAIN_ID": str(domain)} | loopback_environment(os.environ)


def loopback_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Environment variables that keep DDS on the loopback interface."""
    if "fastrtps" in environment.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"):
        profile = str(share_folder() / "config" / "fastdds_loopback.xml")
        return {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",  # leave discovery to the profile
            "FASTRTPS_DEFAULT_PROFILES_FILE": profile,
            "FASTDDS_DEFAULT_PROFILES_FILE": profile,
        }
    return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
