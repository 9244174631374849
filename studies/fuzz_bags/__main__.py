"""Damage bags, and use them.

python -m studies.fuzz_bags [--cases N] [--seed N] [--output FILE]
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path

import click

from benchmarks.report import Section, machine, save
from knee_contact_ros.system.progress import progress
from studies.fuzz_bags.bags import CHUNK, TICKS
from studies.fuzz_bags.judge import BAD, GOOD, LIMIT, SAID, Verdict, run

ABOUT = (
    f"A recording of {TICKS} ticks is written in every form and damaged at random. It is then read, computed and "
    f"written as `solve` does it, and MCAP files are recovered as well. Each case runs in a process of its own, for at "
    f"most {LIMIT:g} s. MCAP files have chunks of {CHUNK} bytes. The columns are:\n\n"
    "- *no damage found, same answers*: what was damaged carries nothing (free pages, texts that nobody needs), or the "
    "damage left everything as it was.\n"
    "- *damage said, rest solved*: exit code 1, and one line that says what is missing.\n"
    "- *refused*: exit code 2, no output.\n"
    "- *nothing can notice it*: the damage is in the payload of a message that no checksum covers (sqlite3 has none, "
    "and an MCAP writer may leave them out). The answers are then those that the pipeline gives to the damaged bytes "
    "as other libraries read them (`sqlite3` of Python, `mcap`).\n"
    "- the others: what must never be."
)
READ = (
    "Of the cases with damage said: how many messages of the undamaged bag were read, and in how many cases messages "
    "were read that were not in it: damaged bytes that no checksum covers, or one checksum for the whole file."
)


def outcomes(verdicts: Sequence[Verdict], group: str) -> list[list[str]]:
    """Rows of the table of cases by outcome."""
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for verdict in verdicts:
        counts[getattr(verdict, group)][verdict.outcome] += 1
        counts["all"][verdict.outcome] += 1
    names = [*sorted(name for name in counts if name != "all"), "all"]
    return [
        [name, str(counts[name].total()), *(str(counts[name][o]) for o in (*GOOD, *BAD))]
        for name in names
    ]


def reading(verdicts: Sequence[Verdict]) -> list[list[str]]:
    """Rows of the table of messages that were read of damaged bags."""
    rows = []
    for kind in sorted({verdict.kind for verdict in verdicts}):
        said = [
            verdict for verdict in verdicts if verdict.kind == kind and verdict.outcome == SAID
        ]
        lost = sum(verdict.lost for verdict in said) / (2 * TICKS * max(len(said), 1))
        foreign = sum(verdict.foreign > 0 for verdict in said)
        rows.append([kind, str(len(said)), f"{100.0 * (1.0 - lost):.1f} %", str(foreign)])
    return rows


@click.command()
@click.option("--cases", type=click.IntRange(1), default=10_000, show_default=True)
@click.option("--seed", type=int, default=0, show_default=True, help="Of the first case.")
@click.option("--workers", type=click.IntRange(1, 64), default=2, show_default=True)
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    default=Path("docs/studies/fuzz_bags.md"),
    show_default=True,
)
def main(cases: int, seed: int, workers: int, output: Path) -> None:
    """Damage bags by the thousand, use them, and write the outcomes."""
    verdicts = []
    with progress("Damaging bags") as advance:
        for verdict in run(range(seed, seed + cases), workers):
            verdicts.append(verdict)
            advance(len(verdicts), cases)
            if verdict.outcome in BAD:
                click.echo(f"{verdict}", err=True)
    header = ("", "cases", *GOOD, *BAD)
    sections = [
        Section("", ABOUT, header, outcomes(verdicts, "kind")),
        Section("By what was done to the bag", "", header, outcomes(verdicts, "mutation")),
        Section(
            "What was read",
            READ,
            ("", "cases", "read", "with unknown messages"),
            reading(verdicts),
        ),
    ]
    command = f"python -m studies.fuzz_bags --cases {cases} --seed {seed}"
    save(output, "Damaged bags", command, sections, machine())
    click.echo(
        f"{output}: {sum(verdict.outcome in BAD for verdict in verdicts)} of {cases} cases are bad"
    )


if __name__ == "__main__":
    main()
