"""Parts that importers of other programs' files share: reading OpenSim's storage files, and writing gait bags."""
