"""A real ROS graph: the node in a process of its own, this process as its peer."""

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from knee_contact_ros.msg import KneeContact
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from knee_contact_ros.bags.bag import RawMessage
from knee_contact_ros.model.kernel import library
from knee_contact_ros.streams.topics import KNEE_CONTACT, types_of
from knee_contact_ros.system.processes import DEATH_SIGNAL_PREFIX
from knee_contact_ros.system.ros import make_executor, private_graph
from tests.helpers.bags import raw_messages
from tests.helpers.forked import COMMAND, Forked
from tests.helpers.messages import RosMessages, header
from tests.helpers.patience import patience, wait_until
from tests.helpers.processes import NO_BYTECODE

STEP = 5_000_000
STAMPS = np.arange(40) * STEP
ANGLES = 0.2 + 0.3 * np.sin(STAMPS * 3e-9)
AXIAL = 1500.0 + 900.0 * np.sin(STAMPS * 2e-8)
"""A little series of samples: their step and stamps [ns], angles [rad] and forces [N]"""
ACQUAINTANCE = 0.1
"""Time [s] in which an idle node hears of a client that has heard of it; a question is asked again after it"""


@pytest.hookimpl(tryfirst=True)  # before the groups are read
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """One process runs all of a file, in turn; each process has a graph of its own."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.xdist_group(item.path.stem))


@pytest.fixture(scope="session", autouse=True)
def graph() -> Iterator[None]:
    """Loopback only, in a domain of our own."""
    with private_graph() as environment:
        os.environ.update(environment)
        library()  # on a new machine nobody waits for that later
        rclpy.init()
        yield
        rclpy.shutdown()


def own_words(errors: str) -> str:
    """What a program has said of its own, without progress; Fast DDS tells of ports that two graphs want, and heals."""
    return "".join(
        line
        for line in errors.splitlines(keepends=True)
        if "RTPS_TRANSPORT_SHM" not in line and not line.startswith("knee-contact demo: ")
    )


WITHOUT = """
import sys
sys.modules.update(dict.fromkeys({0!r}.split(",")))
from knee_contact_ros.commands.main import main
sys.exit(main())
"""
"""A program: the command where modules are not installed"""


def flagged(arguments: Sequence[str]) -> Iterator[str]:
    """Put `-p` before each parameter."""
    for before, word in pairwise(("", *arguments)):
        if ":=" in word and before not in ("-p", "-r"):
            yield "-p"
        yield word


class NodeProcess:
    """`knee-contact node`, or another command that runs one, with its output."""

    def __init__(
        self,
        *arguments: str,
        largest_file: int = resource.RLIM_INFINITY,
        without: str = "",
        kind: str = "node",
        anew: bool = False,
    ) -> None:
        """Give it parameters as `name:=value`, and other arguments after their flags.

        `largest_file` [B] makes the disk look full, `without` modules look absent; `kind` is the command.

        It is forked, unless it is to begin `anew`: modules may read environment variables when they are imported.
        """
        words, limited = (
            [*kind.split(), "--ros-args", *flagged(arguments)],
            largest_file != resource.RLIM_INFINITY,
        )
        self.process: Forked | subprocess.Popen[str]
        if anew or limited:
            command = ["-c", WITHOUT.format(without)] if without else ["-m", COMMAND]
            self.process = subprocess.Popen(
                [*DEATH_SIGNAL_PREFIX, sys.executable, *command, *words],
                text=True,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                env=os.environ | (NO_BYTECODE if limited else {}),
            )
        else:
            self.process = Forked(words, without)
        resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE, (largest_file, largest_file))

    def stop(self, number: signal.Signals = signal.SIGINT) -> str:
        """End it by a signal, which must go well; return all it said."""
        code, output = self.end(number)
        assert code == 0, output
        assert "Traceback" not in output
        return output

    def end(self, number: signal.Signals | None = None) -> tuple[int, str]:
        """Wait for its end, which a signal may ask for; return its code and all it said."""
        if number and self.process.poll() is None:
            self.process.send_signal(number)
        output, _ = self.process.communicate(timeout=patience())
        return self.process.wait(patience()), own_words(output)


class Peer:
    """Publishes samples and listens to answers."""

    def __init__(self, namespace: str = "", joint_states: str = "joint_states") -> None:
        self.node = Node("peer", namespace=namespace)
        self.executor = make_executor(self.node)
        self.contacts: list[KneeContact] = []
        self.wrenches: list[WrenchStamped] = []
        self.diagnostics: dict[str, dict[str, str]] = {}
        self.reported: list[tuple[str, dict[str, str]]] = []
        """All entries of `/diagnostics`, in order: names and values"""
        self.problems: dict[str, str] = {}
        self.reports = 0
        """How many messages of `/diagnostics` have come"""
        self.told: set[str] = set()
        """All that `/diagnostics` has said, by any entry"""
        self.stalled: list[subprocess.Popen[str]] = []
        self.clients: dict[tuple[type, str], Any] = {}
        """Clients of services, by type and name"""
        self.node_process = 0
        """Its number, for faults that need it"""
        qos = QoSProfile(depth=1000)
        self.angle = self.node.create_publisher(JointState, joint_states, qos)
        self.force = self.node.create_publisher(WrenchStamped, "joint_reaction_force", qos)
        self.node.create_subscription(KneeContact, "knee_contact", self.contacts.append, qos)
        self.node.create_subscription(
            WrenchStamped, "knee_contact/wrench", self.wrenches.append, qos
        )
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.on_diagnostics, qos)

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Keep the newest values of every entry."""
        self.reports += 1
        for status in message.status:
            self.diagnostics[status.name] = {value.key: value.value for value in status.values}
            self.reported.append((status.name, self.diagnostics[status.name]))
            self.problems[status.name] = status.message
            self.told.add(status.message)

    def has_received(self, topic: str, number: int) -> bool:
        """Whether the node says that so many samples of a topic have come."""
        return self.diagnostics.get(f"knee_contact: {topic}", {}).get("received") == str(number)

    def wait_until(self, done: Callable[[], Any]) -> None:
        """Spin until something has happened."""
        wait_until(done, partial(self.executor.spin_once, timeout_sec=0.05))

    def spin(self, seconds: float) -> None:
        """Spin for a while."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=left)

    def wait_for_node(self) -> None:
        """Wait until the node listens and speaks, and knows that we do."""
        self.wait_until(
            lambda: (
                self.angle.get_subscription_count()
                and self.force.get_subscription_count()
                and self.node.count_publishers("knee_contact")
                and self.node.count_publishers("/diagnostics")
            )
        )
        speakers = self.node.get_publishers_info_by_topic("knee_contact")
        for name in {f"{info.node_namespace}/{info.node_name}" for info in speakers}:
            self.introduce("/" + name.lstrip("/"))

    def introduce(self, node: str) -> None:
        """Wait until a node knows our publishers, subscriptions and clients.

        It hears of them in the order in which they were made: when it can answer a new client, it knows the rest. A
        mere pause lost first answers on a busy machine.
        """
        client = self.node.create_client(GetState, f"{node}/get_state")
        self.wait_until(client.service_is_ready)
        asked: list[Any] = []

        def is_answered() -> bool:
            if not asked or time.monotonic() > begin + len(asked) * ACQUAINTANCE:
                asked.append(client.call_async(GetState.Request()))
            return any(future.done() for future in asked)

        begin = time.monotonic()
        self.wait_until(is_answered)
        self.node.destroy_client(client)

    def client(self, service_type: type, name: str) -> Any:
        """Get a client of a service that the node knows, too: it cannot answer one of whom it has yet to hear."""
        kind = service_type, name
        if kind not in self.clients:
            self.clients[kind] = self.node.create_client(service_type, name)
            self.introduce(name.rpartition("/")[0])
        self.wait_until(self.clients[kind].service_is_ready)
        return self.clients[kind]

    def send_angle(self, stamp: int, angle: float, joint: str = "knee") -> None:
        """Publish a flexion angle [rad] at a stamp [ns]."""
        self.angle.publish(
            JointState(header=header(RosMessages, stamp, ""), name=[joint], position=[angle])
        )

    def send_force(self, stamp: int, axial: float, frame: str = "tibia_r") -> None:
        """Publish an axial compression [N] at a stamp [ns]."""
        wrench = RosMessages.Wrench(force=RosMessages.Vector3(x=0.0, y=-axial, z=0.0))
        self.force.publish(WrenchStamped(header=header(RosMessages, stamp, frame), wrench=wrench))

    def send(self, stamp: int, angle: float, axial: float) -> None:
        """Publish both."""
        self.send_angle(stamp, angle)
        self.send_force(stamp, axial)

    def send_series(self) -> None:
        """Publish the little series and wait for its answers."""
        for stamp, angle, axial in zip(
            STAMPS.tolist(), ANGLES.tolist(), AXIAL.tolist(), strict=True
        ):
            self.send(stamp, angle, axial)
        self.wait_until(
            lambda: len(self.contacts) == len(STAMPS) and len(self.wrenches) == len(STAMPS)
        )


def raw(path: Path, topics: Iterable[str]) -> list[RawMessage]:
    """The messages of some topics in a recording."""
    return raw_messages(path, types_of(topics))


def answers_in(path: Path) -> list[KneeContact]:
    """The answers in a recording."""
    return [
        deserialize_message(message.data, KneeContact) for message in raw(path, [KNEE_CONTACT])
    ]


def call(peer: Peer, service_type: type, name: str, request: object) -> Any:
    """Call a service and wait for its answer."""
    future = peer.client(service_type, name).call_async(request)
    peer.wait_until(future.done)
    return future.result()


def trigger(peer: Peer, name: str, node: str = "/knee_contact") -> tuple[bool, str]:
    """Call a service of a node that only has an answer."""
    answer = call(peer, Trigger, f"{node}/{name}", Trigger.Request())
    return answer.success, answer.message


def set_parameters(
    peer: Peer, values: Mapping[str, object], node: str = "/knee_contact"
) -> tuple[bool, str]:
    """Set parameters of a node all at once."""
    changes = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    request = SetParametersAtomically.Request(parameters=changes)
    result = call(
        peer, SetParametersAtomically, f"{node}/set_parameters_atomically", request
    ).result
    return result.successful, result.reason


def change_state(peer: Peer, transition: int | str, node: str = "knee_contact") -> bool:
    """Ask the node for a transition of its life cycle, by number or name; whether it succeeded."""
    field = "label" if isinstance(transition, str) else "id"
    request = ChangeState.Request(transition=Transition(**{field: transition}))
    return bool(call(peer, ChangeState, f"/{node}/change_state", request).success)


def state_of(peer: Peer, node: str = "knee_contact") -> int:
    """The node's state in its life cycle."""
    return int(call(peer, GetState, f"/{node}/get_state", GetState.Request()).current_state.id)


@pytest.fixture
def peer() -> Iterator[Peer]:
    """This process's side of the graph."""
    peer = Peer()
    yield peer
    peer.executor.shutdown()
    peer.node.destroy_node()


Start = Callable[..., NodeProcess]


@pytest.fixture
def start_node() -> Iterator[Start]:
    """Start nodes; all are gone after the test."""
    started: list[NodeProcess] = []

    def start(*arguments: str | Path, **how: Any) -> NodeProcess:
        started.append(NodeProcess(*map(str, arguments), **how))
        return started[-1]

    yield start
    for node in started:
        if (
            node.process.poll() is None
        ):  # a test has failed: neither the node nor what it has started is left
            for child in psutil.Process(node.process.pid).children(recursive=True):
                child.kill()
            node.process.kill()
        node.process.communicate(timeout=patience())
