"""Starts, watches and ends the package's other processes, so that none is left behind; finds their TCP ports."""

import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import IO, Any, NamedTuple

from .errors import UsageError

Process = subprocess.Popen[bytes]
EXIT_PATIENCE = 30.0
"""Usual longest time [s] that a process may take to end"""
INFO_MARK = "[INFO]"
"""Mark of ROS log lines that report nothing wrong"""
EXIT_TIMEOUT = 5.0
"""Longest time [s] that a process may take to end once its socket is closed"""
SOCKET_BUFFER = 1 << 18
"""Requested memory [B] of a socket, of which Linux gives what it allows: a process that is busy gets it all the same"""
RUN_MODULE = (
    "import sys; sys.path[:] = filter(None, sys.path); del sys.argv[0]; "
    "import runpy; runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)"
)
"""Replacement for `python -P -m`, which Python 3.10 does not have"""
OWN_PROCESS_GROUP: dict[str, Any] = (
    {"process_group": 0} if sys.version_info >= (3, 11) else {"preexec_fn": os.setpgrp}
)
"""Arguments of `Popen` for a process group of its own"""
DEATH_SIGNAL_PREFIX = (
    [setpriv, "--pdeathsig", "TERM"] if (setpriv := shutil.which("setpriv")) else []
)
"""Prefix of a command that then gets SIGTERM when the thread that started it ends, if the command has begun"""


class Child(NamedTuple):
    """Process with a log of its output."""

    name: str
    """Name for messages"""
    process: Process
    log: Path
    """File with the output of the process"""

    def check(self) -> None:
        """Check that the process still runs.

        Raises:
            UsageError: it has ended; the text has the last line of its output above the level of information.
        """
        if self.process.poll() is not None:
            lines = self.log.read_text(
                encoding="utf-8", errors="replace"
            ).strip().splitlines() or ["it said nothing"]
            last = next((line for line in reversed(lines) if INFO_MARK not in line), lines[-1])
            raise UsageError(f"{self.name} ended with code {self.process.returncode}: {last}")


def start_process(command: Sequence[str], output: IO[bytes] | None, **options: Any) -> Process:
    """Start a process without input, with its output to `output` (None: to ours); `options` are those of `Popen`.

    Raises:
        OSError: it cannot be started.
    """
    return subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=output, stderr=output, **options
    )


@contextmanager
def running(
    command: Sequence[str], output: IO[bytes], patience: float, **options: Any
) -> Iterator[Process]:
    """Run a process within the `with` block; always end it, also if this process is killed."""
    process = None
    try:
        with delay_signals():
            process = start_process([*DEATH_SIGNAL_PREFIX, *command], output, **options)
        yield process
    finally:
        if process:
            end_process(process, patience)


@contextmanager
def child_process(
    name: str, arguments: Sequence[str], log: Path, patience: float = EXIT_PATIENCE
) -> Iterator[Child]:
    """Run `python` with these arguments and its output in `log`; at the end it gets SIGINT and `patience` [s].

    Raises:
        UsageError: the process has failed, or did not end.
    """
    try:
        with (
            log.open("wb") as output,
            running([sys.executable, *arguments], output, patience) as process,
        ):
            child = Child(name, process, log)
            yield child
            process.send_signal(signal.SIGINT)
            process.wait(patience)
            if process.returncode:
                child.check()
    except subprocess.TimeoutExpired:
        raise UsageError(f"{name} did not end within {patience:g} s") from None


def python_module(module: str, *arguments: str) -> dict[str, Any]:
    """Return arguments of `start_process` for a module whose process imports from the same folders as this one.

    The working folder is left out, because a file there may have the name of a library.
    """
    path = os.pathsep.join(str(Path(folder).absolute()) for folder in sys.path)
    command = [sys.executable, "-c", RUN_MODULE, module, *arguments]
    return {"command": command, "env": os.environ | {"PYTHONPATH": path}}


def written_by(module: str, path: Path, *more: str, library: str, patience: float = 60.0) -> bytes:
    """Return what a module writes that reads a file by a library, in a process of its own: a damaged file may end it.

    The module's command line is `INPUT OUTPUT`, and `more`. To be used in the main thread.

    Raises:
        ValueError: the process ended by a signal, took longer than `patience` [s], or failed; then the text is that
            of its exception.
        OSError: no process can be started.
    """
    with TemporaryDirectory() as folder, Path(folder, "log").open("w+b") as log:
        output = Path(folder, "output")
        own = python_module(module, str(path.absolute()), str(output), *more)
        with running(output=log, patience=1.0, **own) as process:
            try:
                code = process.wait(patience)
            except subprocess.TimeoutExpired:
                raise ValueError(f"{library} does not read it within {patience:g} s") from None
        if code < 0:
            raise ValueError(f"{library} ended by signal {-code}; is it damaged?")
        if code:
            log.seek(0)
            last = log.read().decode(errors="replace").strip().rpartition("\n")[2]
            raise ValueError(last.partition(": ")[2] or last)  # without the name of an exception
        return output.read_bytes()


def start_connected(module: str, *arguments: str) -> tuple[Connection, Process]:
    """Start a module in a process of its own; return our end of a pair of sockets, and the process.

    The first argument of its command line is the number of its own end. The process has its own process group, so that
    Ctrl-C in a terminal does not end it before we do. It does not have its own session: Linux may divide processor time
    by session (`sched_autogroup_enabled`). Then a process with little work would starve when another session is busy,
    and niceness would have no effect.

    Raises:
        OSError: no process can be started.
    """
    ours, theirs = socket.socketpair()
    with ours, theirs:
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BUFFER)
        options = python_module(module, str(theirs.fileno()), *arguments)
        process = start_process(
            output=None, pass_fds=[theirs.fileno()], **OWN_PROCESS_GROUP, **options
        )
        return Connection(ours.detach()), process


def reap_process(process: Process) -> int:
    """Wait for a process whose connection is closed, and kill it if it does not end; return its exit code."""
    with suppress(subprocess.TimeoutExpired):
        return process.wait(EXIT_TIMEOUT)
    process.kill()
    return process.wait(EXIT_TIMEOUT)


def end_process(process: Process, patience: float) -> None:
    """Terminate a process that still runs; kill it after `patience` [s], or if the waiting is interrupted."""
    try:
        with suppress(subprocess.TimeoutExpired):
            process.terminate()  # which does nothing to one that has ended
            process.wait(patience)
    finally:
        process.kill()
        process.wait()


@contextmanager
def delay_signals() -> Iterator[None]:
    """Delay SIGINT and SIGTERM until the end of the `with` block, so that they do not interrupt the start of a process.

    To be used in the main thread, the only one that handles signals.
    """
    came: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _frame: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for late in came:
            signal.raise_signal(late)


@contextmanager
def interrupted_by_sigterm() -> Iterator[None]:
    """Make SIGTERM act like Ctrl-C within the `with` block, so that unfinished work is cleaned up.

    To be used in the main thread, the only one that handles signals.

    Raises:
        KeyboardInterrupt: SIGTERM came.
    """

    def on_terminate(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGTERM, on_terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)


@contextmanager
def ignoring_interrupts() -> Iterator[None]:
    """Make processes and threads that start in this context ignore Ctrl-C; the caller receives it and ends them.

    On Windows they receive it, too.
    """
    if sys.platform == "win32":
        yield
        return
    # The tracker lets the signal through again in the thread that starts it, so it is started before.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def unwinding_on_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the process by an exception, so that context managers restore everything."""

    def end(number: int, _frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    ours = [
        number
        for number in {signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)}
        if signal.getsignal(number) == signal.SIG_DFL
    ]
    for number in ours:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


LOCALHOST = "127.0.0.1"


def free_port(address: str = LOCALHOST) -> int:
    """Find a port that no process listens on at an address of this machine."""
    with socket.socket() as probe:
        probe.bind((address, 0))
        return int(probe.getsockname()[1])


def check_port_free(port: int, name: str) -> None:
    """Check that a port can be listened on; `name` is the parameter or option that gave it.

    Raises:
        UsageError: another process listens on it, or it is not allowed.
    """
    with socket.socket() as probe:
        # As the server does: otherwise closed connections that linger would take the port. On Windows the usual option
        # would let two servers share it.
        option = getattr(socket, "SO_EXCLUSIVEADDRUSE", socket.SO_REUSEADDR)
        probe.setsockopt(socket.SOL_SOCKET, option, 1)
        try:
            probe.bind((LOCALHOST, port))
        except OSError as error:
            raise UsageError(f"{name}: {port} on {LOCALHOST}: {error.strerror}") from None
