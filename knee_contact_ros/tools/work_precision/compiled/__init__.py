"""Motion, solvers and runs that are compiled, shared by `peers` here and by `studies.cohorts`."""
