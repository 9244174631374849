"""Record answers: the inputs that led to a tick, then its outputs, in the order of the ticks.

That order depends on stamps only, so a live recording and an offline one hold the same messages in the same order.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterable, Mapping

from knee_contact_ros.cdr_in import JointState
from knee_contact_ros.cdr_out import encode_joint_state, encode_wrench_stamped
from knee_contact_ros.pipeline import Answer, Ending, Input
from knee_contact_ros.record import REFUSED_SAMPLES, BagWriter
from knee_contact_ros.topics import KNEE_CONTACT, KNEE_CONTACT_WRENCH, MESSAGE_TYPES

ABSOLUTE_NAMES = {topic: f"/{topic}" for topic in MESSAGE_TYPES}


class AnswerWriter:
    """Writes answers into a bag."""

    def __init__(self, bag: BagWriter, names: Mapping[str, str] = ABSOLUTE_NAMES) -> None:
        """`names` gives the absolute name under which each topic is recorded."""
        self.bag = bag
        self._names = names
        for topic, type_name in MESSAGE_TYPES.items():
            bag.add_topic(names[topic], type_name)

    def write(self, answer: Answer) -> None:
        """Write an answer's inputs and outputs."""
        self.write_inputs(answer.inputs)
        self.bag.write(self._names[KNEE_CONTACT], answer.stamp, answer.message)
        self.bag.write(self._names[KNEE_CONTACT_WRENCH], answer.stamp, answer.wrench)

    def finish(self, ending: Ending) -> None:
        """Write the inputs without an answer, and how many samples were refused and why."""
        self.write_inputs(ending.inputs)
        counts = {"total": sum(ending.refused.values())} | ending.refused
        self.bag.add_metadata(REFUSED_SAMPLES, {reason: str(count) for reason, count in counts.items()})

    def write_inputs(self, inputs: Iterable[Input]) -> None:
        """Write input messages anew: what came may hold leftovers of the sender's memory between the fields."""
        for topic, stamp, message in inputs:
            encoded = encode_joint_state(message) if isinstance(message, JointState) else encode_wrench_stamped(message)
            self.bag.write(self._names[topic], stamp, encoded)


class RecorderThread:
    """Writes answers in a thread of its own, so that encoding, compression and the disk never hold up a tick."""

    def __init__(self, writer: AnswerWriter, flush_period: float, on_failure: Callable[[str], None]) -> None:
        """`flush_period` [s] is what a crash may lose; `on_failure` is told once if the disk refuses."""
        self.failure = ""
        self._writer = writer
        self._period = flush_period
        self._on_failure = on_failure
        self._queue: queue.SimpleQueue[Answer | None] = queue.SimpleQueue()
        self._ending = Ending((), {})
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def diagnostics(self) -> dict[str, str]:
        """How many answers wait to be written."""
        return {"backlog": str(self._queue.qsize())}

    def put(self, answer: Answer) -> None:
        """Hand over an answer; after a failure it goes nowhere."""
        if not self.failure:
            self._queue.put(answer)

    def close(self, ending: Ending) -> None:
        """Write what waits and the ending, and complete the file."""
        self._ending = ending
        self._queue.put(None)
        self._thread.join()

    def _run(self) -> None:
        try:
            self._write_all()
            self._writer.finish(self._ending)
            self._writer.bag.close()
        except Exception as error:  # whatever it is, the node must compute on
            reason = error.strerror if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
            self.failure = f"recording {self._writer.bag.partial} stopped: {reason}"
            self._on_failure(self.failure)

    def _write_all(self) -> None:
        flushed = time.monotonic()
        while True:
            try:
                answer = self._queue.get(timeout=self._period)
            except queue.Empty:
                pass
            else:
                if answer is None:
                    return
                self._writer.write(answer)
            if time.monotonic() - flushed >= self._period:
                self._writer.bag.flush()
                flushed = time.monotonic()
