"""Everything beyond one recording: imports from other programs, studies of many knees, fits to data, reports."""
