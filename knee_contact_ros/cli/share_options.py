"""The options of `knee-contact fit-share`."""

from __future__ import annotations

import click

from knee_contact_ros.cli.options import together
from knee_contact_ros.cli.output_option import Output

fit_share_options = together(
    click.option(
        "--trial",
        "trials",
        multiple=True,
        required=True,
        metavar="FILE.csv[,FILE.csv...]",
        help="A trial: a CSV file, or several with one clock, of which the first one says the samples. Once per trial.",
    ),
    click.option("--time", default="time_s", show_default=True, metavar="COLUMN", help="Time [s], in every file."),
    click.option("--axial", required=True, metavar="SUM", help="Axial compression [N], as 'pm + am + pl + al'."),
    click.option("--medial", required=True, metavar="SUM", help="The medial part of it [N], as '0.98 am + 0.97 pm'."),
    click.option("--flexion", required=True, metavar="SUM", help="Flexion angle, as --flexion=-knee_angle."),
    click.option(
        "--angle-unit", type=click.Choice(["deg", "rad"]), default="rad", show_default=True, help="Of --flexion."
    ),
    click.option(
        "--body-weight",
        type=click.FloatRange(10.0, 5000.0),
        multiple=True,
        required=True,
        metavar="N",
        help="Body weight [N]; once, or once per trial.",
    ),
    click.option(
        "--smoothing",
        type=click.FloatRange(1e-8, 1e3),
        default=1e-3,
        show_default=True,
        help="[BW^2] that a step of 1 between neighbours in the table costs, beside the mean square of the error.",
    ),
    click.option("--source", default="", help="Whose data these are: goes into the file."),
    click.option("--output", type=Output(".csv"), required=True, metavar="OUT.csv", help="Table to write."),
    click.option("--overwrite", is_flag=True, help="Replace OUT.csv if it exists."),
)
