"""What a run of a cohort costs, knee for knee, beside what a user would take instead, at the same error."""
