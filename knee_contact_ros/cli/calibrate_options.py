"""The options of `knee-contact calibrate`."""

from __future__ import annotations

import click

from knee_contact_ros.cli.options import DEFAULT_PARAMETERS, parameter_files_option, together
from knee_contact_ros.cli.output_option import Output

calibrate_parameter_files = parameter_files_option("", f"{DEFAULT_PARAMETERS}; with a BAG the load node's defaults")
calibrate_options = together(
    click.option(
        "--free",
        multiple=True,
        required=True,
        metavar="NAME[=LOW:HIGH]",
        help="Parameter to fit, as contact.stiffness or person.tone, in its range or a narrower one; once for each.",
    ),
    click.option(
        "--sigma",
        multiple=True,
        metavar="COLUMN=SD",
        help="Standard deviation of a column's noise, in its unit; else that of what is left of it. Once per column.",
    ),
    click.option(
        "--loss",
        type=click.Choice(["linear", "soft_l1", "huber"]),
        default="linear",
        show_default=True,
        help="linear: least squares; by the others, outliers count less.",
    ),
    click.option(
        "--level",
        type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True),
        default=0.95,
        show_default=True,
        help="Probability of the intervals.",
    ),
    click.option("--no-intervals", "without", is_flag=True, help="Fit only: a tenth of the time."),
    click.option(
        "--starts",
        type=click.IntRange(1, 1000),
        default=4,
        show_default=True,
        help="From how many places to search, so that another minimum is seen.",
    ),
    click.option("--output", type=Output(".yaml"), required=True, metavar="OUT.yaml", help="Parameter file to write."),
    click.option("--overwrite", is_flag=True, help="Replace OUT.yaml if it exists."),
)
