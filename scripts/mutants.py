"""Put faults into a copy of the package, one at a time, and see whether the tests find them.

python -m scripts.mutants [--only PART_OF_A_NAME] [--jobs 2]

Run it before a release: about 15 minutes on two processors. It ends with 1 if a fault is found by no test. Each
fault of `MUTANTS` replaces a piece of code by a wrong one, and names the tests that should see it; a new test, or a new
rule of the model, may get a fault here.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

import click

ROOT = Path(__file__).parents[1]
TIME_LIMIT = 300.0
"""Time [s] after which the tests of a fault are ended; the fault is not found then"""
FAILED = 1
"""Exit code of pytest if tests failed; another one means that it could not run them"""
LIBRARIES = "knee_contact_ros/model/*.so"
"""Pattern of the compiled model, which is copied, so that only faults of the model compile it again"""


class Mutant(NamedTuple):
    """Fault of the package."""

    name: str
    """What is wrong"""
    file: str
    """Module in the package"""
    code: str
    """Piece of the module's text, which occurs once"""
    fault: str
    """Text in its place"""
    tests: str
    """Files or folders of `tests/` that should find it, separated by spaces"""


MUTANTS = (
    # The contact model
    Mutant(
        "a law's force is 0.1 % too high",
        "model/laws.py",
        "return float(law[layer, BASE]) + elastic + damping * rate",
        "return float(law[layer, BASE]) + 1.001 * elastic + damping * rate",
        "model/test_laws.py",
    ),
    Mutant(
        "the loss number of flores",
        "model/laws.py",
        "8.0 * (1.0 - restitution) / (5.0 * restitution)",
        "8.0 * (1.0 - restitution) / (5.1 * restitution)",
        "model/test_laws.py",
    ),
    Mutant(
        "a spline's end slope",
        "model/splines.py",
        "return 2.0, 1.0, 3.0 * chord[0]",
        "return 2.0, 1.0, 6.0 * chord[0]",
        "model/test_splines.py",
    ),
    Mutant(
        "the loading rate over a reset",
        "model/readouts.py",
        'continues = (steps > 0.0) & ((rows["status"][1:] & Status.TIME_RESET) == 0)',
        "continues = steps > 0.0",
        "model/test_readouts.py",
    ),
    Mutant(
        "the peak pressure is the mean one",
        "model/readouts.py",
        'read["peak_pressure"] = self.spread.peak * read',
        'read["peak_pressure"] = read',
        "model/test_readouts.py",
    ),
    Mutant(
        "a coefficient of the explicit tableau",
        "model/tableaux.py",
        "3680 / 513, -845 / 4104)",
        "3680 / 513, -845 / 4105)",
        "model/test_dynamics.py",
    ),
    Mutant(
        "a coefficient of the implicit tableau",
        "model/tableaux.py",
        "69875 / 102672, -2260 / 8211)",
        "69875 / 102672, -2260 / 8215)",
        "model/test_dynamics.py",
    ),
    Mutant(
        "the published error is a quarter too small",
        "model/error_estimate.py",
        "SAFETY_FACTOR = 2.25",
        "SAFETY_FACTOR = 1.5",
        "model/test_error_estimate.py model/test_honesty.py model/test_dynamics.py",
    ),
    Mutant(
        "the sliding velocity without n_y",
        "model/answers.py",
        "angle_rate * (x_slope * normal_y + extent)",
        "angle_rate * (x_slope + extent)",
        "model/test_model.py",
    ),
    Mutant(
        "gaps up to 12 mm are plausible",
        "model/types.py",
        "MAX_SURFACE_GAP = 0.01",
        "MAX_SURFACE_GAP = 0.012",
        "model parameters",
    ),
    Mutant(
        "the contact point of a knee that bends the other way",
        "model/answers.py",
        "words[i, WORD_OF.contact_point_y] = point_y",
        "words[i, WORD_OF.contact_point_y] = -point_y",
        "model/test_model.py model/test_message_values.py",
    ),
    # From sensors to a load
    Mutant(
        "the sign of the centripetal acceleration",
        "joint_reaction/leg.py",
        "arm * complex(-turning.rate * turning.rate",
        "arm * complex(turning.rate * turning.rate",
        "joint_reaction",
    ),
    Mutant(
        "the calf does not help to extend",
        "joint_reaction/muscles.py",
        "extension_moment + calf * gastrocnemius",
        "extension_moment - calf * gastrocnemius",
        "joint_reaction",
    ),
    Mutant(
        "the medial share by the wrong side of the moment",
        "joint_reaction/compartments.py",
        "0.5 * axial - moment / self.spacing",
        "0.5 * axial + moment / self.spacing",
        "parameters/test_shares.py",
    ),
    Mutant(
        "a share between the cells of its table",
        "joint_reaction/compartments.py",
        "(by_load + by_both * right) * up",
        "by_load * up",
        "parameters/test_shares.py",
    ),
    # Streams
    Mutant(
        "a gap of pairing.max_gap is stale",
        "streams/pairing.py",
        "return STALE_INPUT if gap > self._max_gap else STATUS_OK",
        "return STALE_INPUT if gap >= self._max_gap else STATUS_OK",
        "streams/test_pairing.py",
    ),
    Mutant(
        "an angle that waits for a load is old",
        "streams/timeline.py",
        "stamp <= self.last + self.step_limit // LONG_STEP",
        "stamp < self.last",
        "streams/test_pairing.py studies/test_pairing.py",
    ),
    Mutant(
        "an old angle is held without a flag",
        "streams/pairing.py",
        "(before, INPUT_HELD | self._stale(stamp - before.stamp)) if hold",
        "(before, self._stale(stamp - before.stamp)) if hold",
        "streams/test_pairing.py",
    ),
    Mutant(
        "the lateral load has no limit",
        "streams/contact_pipeline.py",
        "if max(abs(medial), abs(load - medial)) > LARGEST_LOAD:",
        "if abs(medial) > LARGEST_LOAD:",
        "streams/test_samples.py",
    ),
    Mutant(
        "the wrench of one compartment instead of the sum",
        "streams/contact_pipeline.py",
        "wrench = head + summed_wrench(rows)",
        "wrench = head + summed_wrench(rows[:1])",
        "streams/test_contact_pipeline.py",
    ),
    Mutant(
        "a motion that is unknown at first counts as known",
        "streams/compartments.py",
        "            self.stream.mark_state_lost()\n",
        "            pass\n",
        "streams/test_contact_pipeline.py",
    ),
    Mutant(
        "latency from the beginning of the tick",
        "node/contact_node.py",
        "latency = end - answer.pair.load.arrived",
        "latency = end - begin",
        "node/test_publishing.py",
    ),
    Mutant(
        "the moment of a turned force about y",
        "streams/frames.py",
        "my + pz * fx - px * fz",
        "my - pz * fx + px * fz",
        "streams/test_frames.py",
    ),
    Mutant(
        "a stride with an unusable answer is usable",
        "streams/strides.py",
        ".astype(int) & UNUSABLE).any()",
        ".astype(int) & 0).any()",
        "streams/test_strides.py",
    ),
    Mutant(
        "the sliding distance of speeds that turn round",
        "streams/strides.py",
        "turned = begin * end < 0.0",
        "turned = begin * end < -1e9",
        "streams/test_strides.py",
    ),
    Mutant(
        "the older of two angles with the stamp of a load",
        "streams/pairing.py",
        "while len(angles) > 1 and angles[1].stamp <= stamp:",
        "while len(angles) > 1 and angles[1].stamp < stamp:",
        "streams/test_pairing.py streams/test_load_pipeline.py offline",
    ),
    Mutant(
        "the wrench of both compartments is that of one",
        "streams/compartments.py",
        "wrench = tuple(map(add, wrench, WRENCH_NUMBERS",
        "wrench = tuple(map(max, wrench, WRENCH_NUMBERS",
        "streams offline",
    ),
    Mutant(
        "publishers that alternate slowly are not found",
        "streams/publisher_conflicts.py",
        "LONGEST_RETURN = 0.05",
        "LONGEST_RETURN = 0.03",
        "streams/test_publisher_conflicts.py",
    ),
    Mutant(
        "a heel strike is 30 ms early",
        "streams/gait_events.py",
        "HEEL_STRIKE: 30_000_000",
        "HEEL_STRIKE: -30_000_000",
        "streams/test_gait_events.py streams/test_strides.py",
    ),
    # Recordings
    Mutant(
        "sequence numbers begin again in each file",
        "bags/recorder.py",
        "earlier = {topic: self.file.next_sequence(topic) for topic in self.file.channels}",
        "earlier = {topic: 0 for topic in self.file.channels}",
        "bags/test_split.py",
    ),
    Mutant(
        "a file is split a moment too late",
        "bags/recorder.py",
        "if span < limits.duration and",
        "if span <= limits.duration and",
        "bags/test_split.py",
    ),
    Mutant(
        "the present file is not synced to the disk",
        "bags/recorder.py",
        "            file.sync()\n        self.file.sync()",
        "            file.sync()",
        "bags/test_disk.py bags/test_recorder.py",
    ),
    Mutant(
        "a damaged chunk is read",
        "bags/mcap_file.py",
        "if chunk.checksum and zlib.crc32(data) != chunk.checksum:",
        "if chunk.checksum and zlib.crc32(data) != chunk.checksum and not data:",
        "bags",
    ),
    Mutant(
        "the digest of a bag leaves out the names of its files",
        "bags/folder.py",
        'f"{path.name} {sha256_of(file)}\\n"',
        'f"{sha256_of(file)}\\n"',
        "bags offline",
    ),
    # Parameters
    Mutant(
        "an earlier parameter file wins",
        "parameters/files.py",
        "before = merged = merged | given",
        "before = merged = given | merged",
        "parameters",
    ),
    # From the laboratory
    Mutant(
        "a per cent of body weight is a tenth",
        "lab/units.py",
        "PERCENT_BODY_WEIGHT: 0.01,",
        "PERCENT_BODY_WEIGHT: 0.1,",
        "lab/test_tables.py lab/test_sensors.py",
    ),
    Mutant(
        "radians up to 6.9 pass as degrees",
        "lab/checks.py",
        "_LARGEST_RADIANS = 3.5",
        "_LARGEST_RADIANS = 6.9",
        "lab/opensim/test_results.py",
    ),
    Mutant(
        "intervals of a fit are a third too narrow",
        "lab/calibrate/intervals.py",
        "minuit.errordef = 0.5 * fit.quantile(level)",
        "minuit.errordef = 0.2 * fit.quantile(level)",
        "lab/calibrate",
    ),
    Mutant(
        "an outcome of a study takes another field",
        "lab/outcomes.py",
        '"peak_depth": "penetration_depth",',
        '"peak_depth": "cartilage_depth",',
        "lab/sweep",
    ),
    Mutant(
        "a file of a folder is not flagged as damaged where its end is missing",
        "bags/mcap_file.py",
        "the end is missing: the recording was cut off",
        "the end is there",
        "bags",
    ),
    Mutant(
        "an existing output is replaced",
        "system/output_files.py",
        "            rename_new(partial, name)",
        "            partial.replace(name)",
        "bags system",
    ),
    # The node
    Mutant(
        "an answer at the deadline is missed",
        "node/diagnostics.py",
        "self.missed += latency + self._lag > deadline",
        "self.missed += latency + self._lag > 2.0 * deadline",
        "node/test_diagnostics.py",
    ),
    # What a person sees
    Mutant(
        "a picture in metres",
        "view/picture.py",
        "depth = MM * picture.depth",
        "depth = picture.depth",
        "view",
    ),
    Mutant(
        "a partial result ends with 0",
        "commands/main.py",
        "except (UsageError, IncompleteError) as error:",
        "except UsageError as error:",
        "commands/test_main.py offline",
    ),
)


class Outcome(NamedTuple):
    """What the tests say of a fault."""

    mutant: Mutant
    found: bool
    said: str
    """First test that failed, or why none did"""
    seconds: float


def mutated(mutant: Mutant, source: str) -> str:
    """Return the text of a module with a fault.

    Raises:
        ValueError: the piece of code does not occur exactly once.
    """
    if (count := source.count(mutant.code)) != 1:
        raise ValueError(f"{mutant.name}: {mutant.file} has {mutant.code!r} {count} times")
    return source.replace(mutant.code, mutant.fault)


def copy_of_the_project(folder: Path) -> Path:
    """Copy the files of this checkout that git knows or does not ignore, and the compiled model."""
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True)
    for name in filter(None, names.stdout.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    for library in ROOT.glob(LIBRARIES):
        shutil.copy2(library, folder / library.relative_to(ROOT))
    return folder


def run_tests(tests: Sequence[str], folder: Path) -> tuple[int | None, str]:
    """Run tests in a copy until one fails; return pytest's exit code, None after `TIME_LIMIT`, and what it said."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--no-header", "-p", "no:cacheprovider"]
    command += ["-p", "no:xdist", "--tb=no", *(f"tests/{one}" for one in tests)]
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        output, _ = process.communicate(timeout=TIME_LIMIT)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        process.communicate()
        return None, f"no end after {TIME_LIMIT:.0f} s"
    failed = [line for line in output.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return process.returncode, failed[0] if failed else output.strip().splitlines()[-1]


def outcome_of(mutant: Mutant, folder: Path) -> Outcome:
    """Put a fault into a copy, run its tests, and restore the copy; the test that fails must pass there again."""
    module = folder / "knee_contact_ros" / mutant.file
    source, begin = module.read_text(encoding="utf-8"), time.monotonic()
    try:
        module.write_text(mutated(mutant, source), encoding="utf-8")
        code, said = run_tests(mutant.tests.split(), folder)
    finally:
        module.write_text(source, encoding="utf-8")
    if found := code == FAILED:
        # All its cases: what a case is called may come from what is computed.
        failed = said.split(maxsplit=1)[1].partition("[")[0].partition(" - ")[0]
        failed = failed.removeprefix("tests/")
        code, again = run_tests([failed], folder)
        if not (found := code == 0):
            said = f"without the fault, too, {again}"
    return Outcome(mutant, found, said, time.monotonic() - begin)


@click.command()
@click.option("--only", default="", help="Only faults whose name or module has this part.")
@click.option("--jobs", default=2, type=click.IntRange(1), help="Faults that are tried at a time.")
def main(only: str, jobs: int) -> None:
    """Try the faults, and print which test found each."""
    chosen = [one for one in MUTANTS if only in f"{one.name} {one.file}"]
    with tempfile.TemporaryDirectory() as temporary, ThreadPoolExecutor(jobs) as pool:
        folders = SimpleQueue[Path]()
        for number in range(jobs):
            folders.put(copy_of_the_project(Path(temporary) / f"copy_{number}"))

        def tried(mutant: Mutant) -> Outcome:
            folder = folders.get()
            try:
                return outcome_of(mutant, folder)
            finally:
                folders.put(folder)

        missed = []
        for outcome in pool.map(tried, chosen):
            verdict = "found " if outcome.found else "MISSED"
            print(
                f"{verdict} {outcome.seconds:5.0f} s  {outcome.mutant.name}: {outcome.said}",
                flush=True,
            )
            missed += [] if outcome.found else [outcome.mutant.name]
    print(f"{len(chosen) - len(missed)} of {len(chosen)} faults found")
    sys.exit(bool(missed))


if __name__ == "__main__":
    main()
