"""Joins a ROS graph, or a private one on loopback, and makes the fastest executor for its callbacks."""

import os
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress

from domain_coordinator import domain_id
from rclpy.exceptions import NameValidationException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node

from .errors import UsageError
from .files import share_folder


@contextmanager
def one_line_ros_errors() -> Iterator[None]:
    """Turn errors of rclpy within the `with` block, such as missing security files, into one line.

    Raises:
        UsageError: the ROS graph cannot be joined.
    """
    with warnings.catch_warnings():
        # After the failure rclpy warns of what it could not clean up.
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            yield
        # All errors of rclpy but NameValidationException derive from RuntimeError.
        except (RuntimeError, NameValidationException) as error:
            reason = str(error).removesuffix("^")
            raise UsageError(f"cannot join the ROS graph: {reason}") from None


@contextmanager
def private_graph() -> Iterator[dict[str, str]]:
    """Yield environment variables for processes that communicate only with each other, and with nothing else.

    `ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST` alone still opens sockets on every interface with Fast DDS; the profile in
    `config/fastdds_loopback.xml` binds them all to 127.0.0.1.
    """
    with domain_id() as domain:
        yield {"ROS_DOMAIN_ID": str(domain)} | loopback_environment(os.environ)


def graph_words() -> str:
    """Return a phrase for the ROS graph in which this process looks for others."""
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    discovery = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") or "SUBNET"
    return f"ROS domain {domain}, discovery range {discovery}"


def loopback_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Return environment variables that keep DDS on the loopback interface."""
    if "fastrtps" in environment.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"):
        profile = str(share_folder() / "config" / "fastdds_loopback.xml")
        return {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",  # leave discovery to the profile
            "FASTRTPS_DEFAULT_PROFILES_FILE": profile,
            "FASTDDS_DEFAULT_PROFILES_FILE": profile,
        }
    return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


FastestExecutor: type[Executor] = SingleThreadedExecutor
with suppress(ImportError):  # Jazzy before rclpy 7.1.4
    from rclpy.experimental import EventsExecutor

    FastestExecutor = EventsExecutor

NO_EVENTS_EXECUTOR = (
    "this rclpy has no EventsExecutor (Jazzy has it from 7.1.4 on): the single-threaded executor is used, which takes "
    "more time per message"
)


def make_executor(*nodes: Node) -> Executor:
    """Make the fastest available executor with some nodes; the first node logs if it is not the events executor.

    To be used with `spin_once(timeout_sec=...)` in a loop: in `spin`, and without a time-out, the events executor of
    Jazzy's wheels keeps a processor busy and delivers nothing.
    """
    if FastestExecutor is SingleThreadedExecutor:
        nodes[0].get_logger().warning(NO_EVENTS_EXECUTOR)
    executor = FastestExecutor(context=nodes[0].context)
    for node in nodes:
        executor.add_node(node)
    return executor


WILDCARD_STAND_IN = "ANY_TEXT"
"""Replacement for `*` where ROS allows only names"""


def resolve_topic(node: Node, topic: str) -> str:
    """Return the absolute name of a topic of a node; `*` in it stays."""
    name: str = node.resolve_topic_name(topic.replace("*", WILDCARD_STAND_IN))
    return name.replace(WILDCARD_STAND_IN, "*")
