"""Many knees through the same gait: the cases of a study, their outcomes, and the tables that hold them."""
