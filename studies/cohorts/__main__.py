"""Time per knee of whole cohorts, beside what a user would take instead at the same error.

python -m studies.cohorts [--cases N ...] [--peer NAME ...] [--rounds N] [--output FILE]

The peers come with the extra `peers`; those that are not installed are named as such on the page.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import click

from benchmarks.report import save
from studies.cohorts.measure import Finalist, Timed, timed
from studies.cohorts.page import TITLE, measured_on, sections
from studies.cohorts.peers import OURS, PEERS, Peer
from studies.cohorts.problem import Cohort, Floats, cohort, truth
from studies.cohorts.search import Setting
from studies.cohorts.worker import Workers, search_setting

SEARCH_CASES = 256
BEST = 2
"""Methods that are timed, of a tool with error control and of one without"""


def searched(peers: Sequence[Peer], workers: Workers, knees: Cohort, depths: Floats) -> list[Finalist]:
    """Search the setting of every method of every tool, in one process per tool, one after the other."""
    searched_methods = []
    for peer in peers:
        for method in peer.methods():
            try:
                setting = workers.of(peer.driver)[0].submit(search_setting, method.key, knees, depths).result()
            except Exception as error:  # whatever a tool raises; its cause is the traceback in the process
                click.echo(f"{method.key}: {error.__cause__ or error}", err=True)
                setting = Setting(method.key, math.nan, math.inf, math.nan, math.nan)
            click.echo(f"{method.key}: {setting.value:.2g}, {setting.error:.1e} m, {setting.per_tick * 1e6:.3g} us")
            searched_methods.append(Finalist(peer, method, setting))
    return searched_methods


def finalists(searched_methods: Sequence[Finalist]) -> list[Finalist]:
    """Choose the quickest methods of every tool, with and without error control."""
    kinds: dict[tuple[str, str], list[Finalist]] = {}
    for one in searched_methods:
        if not math.isnan(one.setting.per_tick):
            kinds.setdefault((one.method.tool, one.method.control), []).append(one)
    return [one for kind in kinds.values() for one in sorted(kind, key=lambda one: one.setting.per_tick)[:BEST]]


@click.command()
@click.option("--cases", multiple=True, type=click.IntRange(32), default=(256, 2048), show_default=True)
@click.option("--peer", "names", multiple=True, type=click.Choice([peer.name for peer in PEERS]), help="[default: all]")
@click.option("--rounds", type=click.IntRange(1), default=7, show_default=True)
@click.option("--output", type=click.Path(path_type=Path), default=Path("docs/studies/cohorts.md"), show_default=True)
def main(cases: tuple[int, ...], names: tuple[str, ...], rounds: int, output: Path) -> None:
    """Measure and write the page."""
    machine = measured_on()
    peers = [OURS, *(peer for peer in PEERS if peer.installed and (not names or peer.name in names))]
    knees = cohort(max(cases))
    depths = truth(knees)
    options = [*(f"--cases {count}" for count in cases), *(f"--peer '{name}'" for name in names), f"--rounds {rounds}"]
    command = " ".join(["python -m studies.cohorts", *options])
    measured: list[list[Timed]] = []
    workers = Workers()
    try:
        searched_methods = searched(peers, workers, knees.first(SEARCH_CASES), depths[:SEARCH_CASES])
        for count in sorted(cases):
            measured.append(timed(finalists(searched_methods), workers, knees.first(count), depths[:count], rounds))
            click.echo(f"{count} knees timed", err=True)
            settings = [one.setting for one in searched_methods]
            save(output, TITLE, command, sections(measured, settings, knees.ticks, rounds), machine)
    finally:
        workers.close()


if __name__ == "__main__":
    main()
