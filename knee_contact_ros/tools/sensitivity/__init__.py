"""Which parameter matters: indices of Sobol and of Morris for what comes out of a knee, by SALib."""
