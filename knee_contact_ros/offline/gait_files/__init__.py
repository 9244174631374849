"""From other programs' files to a gait bag: what importers share."""
