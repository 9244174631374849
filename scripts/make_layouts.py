#!/usr/bin/env python3
"""Make the layouts for Foxglove and PlotJuggler: `make_layouts.py [--namespace left] --output config`.

They are written into the folders `foxglove` and `plotjuggler` of the output folder.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import claim
from knee_contact_ros.tools.layouts import foxglove, plotjuggler
from knee_contact_ros.tools.layouts.fields import checked


@click.command()
@click.option("--namespace", default="", help="For /NAMESPACE/knee_contact.")
@click.option("--output", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder for both.")
def main(namespace: str, output: Path) -> None:
    """Make the layouts for Foxglove and PlotJuggler."""
    name = "_".join([*checked(namespace).strip("/").split("/"), "knee_contact"]).lstrip("_")
    files = {
        f"foxglove/{name}.json": json.dumps(foxglove.layout(namespace), indent=2) + "\n",
        f"plotjuggler/{name}.xml": plotjuggler.layout(namespace),
        f"plotjuggler/{name}.pj4.xml": plotjuggler.layout_4(namespace),
    }
    for file, text in files.items():
        partial = claim(output / file, overwrite=True)
        partial.write_text(text, encoding="utf-8")
        partial.replace(output / file)
        print(output / file)


if __name__ == "__main__":
    try:
        main(standalone_mode=False)
    except (UsageError, click.ClickException) as error:
        text = error.format_message() if isinstance(error, click.ClickException) else str(error)
        print(f"make_layouts.py: {text}", file=sys.stderr)
        raise SystemExit(2) from None
