"""Sensitivity analysis: Sobol's and Morris's indices of a knee's outcomes to its parameters, by SALib."""
