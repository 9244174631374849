"""`knee-contact` as it is typed."""

from knee_contact_ros.commands.main import main


def run(words):
    """Run a command, whose words are separated by blanks; return its exit code."""
    return main(words.split())
