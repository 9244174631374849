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

    An installation does so by itself. The compiled model is for every kind of knee; --params and -p are only checked.
    It is kept beside the package if you can write there, else in $XDG_CACHE_HOME/knee_contact_ros or
    ~/.cache/knee_contact_ros, for this version of the model, of its compiler and of Python on this kind of processor.
    What is kept already is left as it is.
    """
    from knee_contact_ros.model.compiler import compiled_run, folders, kept_files
    from knee_contact_ros.model.ticks import run
    from knee_contact_ros.parameters.build import load_model
    from knee_contact_ros.system.errors import IncompleteError, UsageError
    from knee_contact_ros.system.files import parameters_of
    from knee_contact_ros.system.terminal import say

    if parameter_files or parameter_values:
        load_model([*find_parameters(parameter_files), parameters_of(parameter_values)], compiled=False)
    before, compiled, after = kept_files(), compiled_run(), kept_files()
    if compiled and after:
        say("was there already" if set(before) == set(after) else "compiled")
        say(f"kept in {after[0].parent}")
        return
    places = folders(run)
    if len(places) == 1:
        raise UsageError(
            f"XDG_CACHE_HOME is not set, and this user has no home and cannot write in {places[0]}: there is no folder "
            "to keep the compiled model in"
        )
    raise IncompleteError(f"the model could not be compiled and kept in {places[0]} or {places[1]}")
