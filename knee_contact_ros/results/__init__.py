"""The answers of a run for notebooks: as a table, as a figure, and as data structures of other libraries."""

from knee_contact_ros.results.results import Results

__all__ = ["Results"]
