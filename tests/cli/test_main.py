"""How the command ends."""

from __future__ import annotations

from collections.abc import Iterator

import click
import pytest

from knee_contact_ros.cli.main import INTERRUPTED, knee_contact, main


@pytest.fixture
def failing() -> Iterator[list[BaseException]]:
    """A command `fail` that raises what is put in the list."""
    raised: list[BaseException] = []

    @knee_contact.command()
    def fail() -> None:
        raise raised[0]

    yield raised
    del knee_contact.commands["fail"]


@pytest.mark.parametrize("error", [KeyboardInterrupt(), click.Abort()])
def test_ctrl_c_is_an_interruption(
    failing: list[BaseException], error: BaseException, capsys: pytest.CaptureFixture[str]
) -> None:
    failing.append(error)
    assert main(["fail"]) == INTERRUPTED
    assert capsys.readouterr().err.strip() == "knee-contact: interrupted"


def test_a_file_that_ends_too_early_is_no_interruption(failing: list[BaseException]) -> None:
    failing.append(EOFError("Ran out of input"))
    with pytest.raises(EOFError, match="Ran out of input"):
        main(["fail"])
