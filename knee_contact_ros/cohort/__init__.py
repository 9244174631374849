"""Many knees through the same gait: cases of a study, what comes out of each, and the tables that hold it."""
