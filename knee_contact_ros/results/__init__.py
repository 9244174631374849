"""The answers of a run as a notebook wants them: a table, a figure, and what other libraries hold them in."""

from knee_contact_ros.results.results import Results

__all__ = ["Results"]
