"""`knee-contact` for shells, by an interpreter that has imported what commands need: it forks one for each command.

Imports are most of what a short command takes. What a shell starts is a small program (`CLIENT`), which hands over its
arguments, folder, environment and streams, passes signals on, and ends with the command's code.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path

from tests import ROOT
from tests.helpers.forked import COMMAND, MODULES

LONGEST = 1 << 20
"""Largest size of a request [B]"""
CLIENT = f"""#!{sys.executable} -IS
import json, os, signal, socket, sys
door = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
door.connect({{path!r}})
deaf = signal.getsignal(signal.SIGINT) == signal.SIG_IGN
request = json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ), deaf])
socket.send_fds(door, [request.encode()], [0, 1, 2])
pid = int(door.recv(20))
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, lambda number, _: os.kill(pid, number))
os._exit(int(door.recv(20) or 1))
"""


@contextmanager
def warm_commands(folder: Path) -> Iterator[Path]:
    """A folder for PATH, with a program `knee-contact`; all that it has started is gone afterwards."""
    door, programs = folder / "door", folder / "programs"
    programs.mkdir()
    program = programs / "knee-contact"
    program.write_text(CLIENT.format(path=str(door)))
    program.chmod(0o755)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(door))
        listener.listen()
        server = subprocess.Popen(
            [sys.executable, "-m", __name__, str(listener.fileno())],
            cwd=ROOT,
            env=os.environ | {"MPLBACKEND": "Agg"},
            pass_fds=[listener.fileno()],
            start_new_session=True,
        )
    try:
        yield programs
    finally:
        with suppress(ProcessLookupError):
            os.killpg(server.pid, signal.SIGKILL)
        server.wait()


def take_note(*_: object) -> None:
    """Take note of the ends of processes."""
    with suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def serve(listener: socket.socket) -> None:
    """Fork a process for each request, until this one is killed."""
    signal.signal(signal.SIGCHLD, take_note)
    while True:
        door, _ = listener.accept()
        request, streams, _, _ = socket.recv_fds(door, LONGEST, 3)
        pid = os.fork()
        if pid == 0:
            listener.close()
            run(door, json.loads(request), streams)
        door.send(str(pid).encode())
        door.close()
        for stream in streams:
            os.close(stream)


def run(
    door: socket.socket, request: tuple[list[str], str, dict[str, str], bool], streams: list[int]
) -> None:
    """In a process of its own: run a command, and tell its code."""
    words, folder, environment, deaf = request
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    if deaf:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["knee-contact", *words]
    code = 1
    try:
        code = import_module(COMMAND).main(words)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        door.send(str(code).encode())
        os._exit(code)


if __name__ == "__main__":
    for module in MODULES:
        import_module(module)
    serve(socket.socket(fileno=int(sys.argv[1])))
