"""Importing this loads the compiled model, for processes that fork others."""

from knee_contact_ros.model.kernel import library

library()
