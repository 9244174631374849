"""What tests need that need not be installed."""

from __future__ import annotations

from importlib.util import find_spec

import pytest

HAS_VIEWER = find_spec("rerun") is not None
"""Whether Rerun is there"""
needs_viewer = pytest.mark.skipif(
    not HAS_VIEWER, reason="needs the extra viewer: pip install 'knee-contact-ros[viewer]'"
)
