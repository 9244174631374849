"""From other programs' results to gait bags."""
