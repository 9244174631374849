"""The command warm: compile what would be compiled at the first start."""

from __future__ import annotations

from pathlib import Path

import click

from knee_contact_ros.cli.options import find_parameters, parameter_files, parameter_values


@click.command()
@parameter_files
@parameter_values
def warm(parameter_files: tuple[Path, ...], parameter_values: tuple[str, ...]) -> None:
    """Compile the model ahead of its first use.

    For the image of a robot, say. Without --params and -p: for each of the package's own parameter files. What is
    compiled is kept in $XDG_CACHE_HOME/knee_contact_ros, else in ~/.cache/knee_contact_ros, for all installations of
    this version of the model and its compiler on this kind of processor. What is kept already is left as it is.
    Each processor compiles one kind of knee at a time.
    """
    from knee_contact_ros.compiled.ahead import compile_ahead
    from knee_contact_ros.compiled.keeping import kernel_folder
    from knee_contact_ros.compiled.kernel import is_kept
    from knee_contact_ros.parameters.build import load_model
    from knee_contact_ros.parameters.reading import Source
    from knee_contact_ros.system.errors import IncompleteError, UsageError
    from knee_contact_ros.system.resources import shipped_parameter_files
    from knee_contact_ros.system.ros_arguments import parameters_of
    from knee_contact_ros.system.terminal import busy, say

    try:
        folder = kernel_folder()
    except RuntimeError:  # this user has no home
        raise UsageError(
            "XDG_CACHE_HOME is not set, and this user has no home: there is no folder to keep kernels in"
        ) from None
    sources: dict[str, Source] = {path.name: path for path in shipped_parameter_files()}
    if parameter_files or parameter_values:
        names = ", ".join([*map(str, parameter_files), *parameter_values])
        sources = {names: [*find_parameters(parameter_files), parameters_of(parameter_values)]}
    models = {name: load_model(source, compiled=True) for name, source in sources.items()}
    missing = [name for name, model in models.items() if not is_kept(model.scene)]
    if missing:
        with busy(f"compiling for {', '.join(missing)}"):
            compile_ahead(models[name].scene for name in missing)
    for name, model in models.items():
        model.stream()
        say(f"{name}: {'compiled' if name in missing else 'was there already'}")
        if not is_kept(model.scene, only_on_disk=True):
            raise IncompleteError(f"what was compiled could not be kept in {folder}")
    say(f"kept in {folder}")
