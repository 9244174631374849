"""The command that imports a laboratory's files, for all tests of what they hold."""

from pathlib import Path

import pytest

from knee_contact_ros.commands.main import main
from tests.lab.trials import MAP, write_csv


@pytest.fixture
def importing(tmp_path, monkeypatch, capsys):
    """Imports cells.csv, made of columns, text or bytes, or other files, by a map into the bag `bag`.

    It returns all that is printed, without line ends; `importing.refused` returns the line of a refusal.
    """
    monkeypatch.chdir(tmp_path)

    def run(code, made=None, text=MAP, *more, files=()):
        if isinstance(made, str):
            made = made.encode()
        if isinstance(made, bytes):
            Path("cells.csv").write_bytes(made)
        elif made:
            write_csv(Path("cells.csv"), made)
        Path("map.yaml").write_text(text, encoding="utf-8")
        files = files or ["cells.csv" if made is not None else "walk.c3d"]
        capsys.readouterr()
        options = ["--map=map.yaml", "--output=bag", "--overwrite", *more]
        assert main(["import-csv", *map(str, files), *options]) == code
        return capsys.readouterr()

    def importing(*arguments, **options):
        return " ".join("".join(run(0, *arguments, **options)).split())

    def refused(*arguments, **options):
        said = run(2, *arguments, **options)
        assert (said.out, said.err.count("\n")) == ("", 1)
        return said.err

    importing.refused = refused
    return importing
