"""Write docs/load-validation.md and its pictures."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import click

from benchmarks.report import Section, machine, save
from studies.load_validation import walks as opensim
from studies.load_validation.answers import answers
from studies.load_validation.opensim_sections import sections as opensim_sections
from studies.load_validation.sections import COMMAND, TITLE, sections
from studies.load_validation.walks import Walk, walks
from studies.validation.data import is_there

PAGE = "load-validation.md"


@click.command()
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    envvar="INSTRUMENTED_KNEE",
    help="Folder with ngait_og5_*.csv and ngait_tm_fast1_*.csv; or the environment's INSTRUMENTED_KNEE.",
)
@click.option(
    "--opensim",
    "model",
    type=click.Path(path_type=Path),
    help="Folder with gait2354's set-up files and OpenSim's results of its walk; needs the extra `opensim`.",
)
@click.option("--work", type=click.Path(path_type=Path), help="Keeps there what OpenSim computes, for the next time.")
@click.option("--output", type=click.Path(path_type=Path), default=Path("docs"), help=f"gets {PAGE} and images/")
def main(data: Path | None, model: Path | None, work: Path | None, output: Path) -> None:
    """Compare with the data, draw, and write the page; without the data, do nothing."""
    if data is None or not is_there(data):
        click.echo(f"no measurements of the instrumented knee in {data or '(no folder given)'}: nothing is made")
        return
    from studies.load_validation.figures import draw

    pair = walks(data)
    found = [*sections(pair), *_beside_opensim(pair, model, work, output)]
    draw(answers(pair), output / "images")
    save(output / PAGE, TITLE, COMMAND, found, machine())


def _beside_opensim(pair: Sequence[Walk], model: Path | None, work: Path | None, output: Path) -> list[Section]:
    """Sections and a picture of the comparison with OpenSim; if something is missing, a sentence that says what."""
    if model is None or not opensim.is_there(model):
        click.echo(f"no walk of gait2354 in {model or '(no folder given)'}: the page has no part about OpenSim")
        return []
    with tempfile.TemporaryDirectory() as temporary:
        place = work or Path(temporary)
        if not opensim.is_computed(place) and not opensim.is_installed():
            click.echo("OpenSim is not installed (pip install -e '.[opensim]'): the page has no part about it")
            return []
        legs = opensim.legs(opensim.computed(model, place))
    from studies.load_validation.figures import draw_opensim

    found = answers([leg.walk for leg in legs])
    draw_opensim(found, legs, output / "images")
    return opensim_sections(legs, found, pair)


if __name__ == "__main__":
    main()
