"""Importing this loads the compiled model, for processes that fork others."""

from __future__ import annotations

from knee_contact_ros.model.kernel import library

library()
