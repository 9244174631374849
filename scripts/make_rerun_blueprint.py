#!/usr/bin/env python3
"""Make the blueprint with which Rerun plots a recording of ours that it has opened by itself.

    make_rerun_blueprint.py --output config/rerun/knee_contact.rbl
    make_rerun_blueprint.py --recording REC.mcap [--namespace left] | rerun REC.mcap -

Rerun uses a blueprint for the recordings of one application id; an MCAP file's application id is its name.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import claim
from knee_contact_ros.tools.layouts.fields import checked
from knee_contact_ros.tools.layouts.rerun_direct import APPLICATION, application_of, save


@click.command()
@click.option("--recording", type=click.Path(exists=True, path_type=Path), help="For this MCAP file, opened directly.")
@click.option("--application-id", default=APPLICATION, show_default=True, help="For recordings of this application id.")
@click.option("--namespace", default="", help="For /NAMESPACE/knee_contact.")
@click.option("--output", type=click.Path(path_type=Path, dir_okay=False), help="[default: standard output]")
def main(recording: Path | None, application_id: str, namespace: str, output: Path | None) -> None:
    """Make the blueprint with which Rerun plots a recording of ours that it has opened by itself."""
    application = application_of(recording) if recording else application_id
    if output is None and sys.stdout.isatty():
        raise UsageError("a blueprint is no text: say --output FILE.rbl, or pipe it into `rerun REC.mcap -`")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "blueprint.rbl"
        save(path, application, checked(namespace))
        if output is None:
            sys.stdout.buffer.write(path.read_bytes())
            return
        partial = claim(output, overwrite=True)
        partial.write_bytes(path.read_bytes())
        partial.replace(output)


if __name__ == "__main__":
    try:
        main(standalone_mode=False)
    except (UsageError, click.ClickException) as error:
        text = error.format_message() if isinstance(error, click.ClickException) else str(error)
        print(f"make_rerun_blueprint.py: {text}", file=sys.stderr)
        raise SystemExit(2) from None
