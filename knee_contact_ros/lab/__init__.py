"""Work beside the computation of one recording: gaits of other programs, studies of many knees, fits to data."""
