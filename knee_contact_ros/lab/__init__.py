"""Work beside the computation of one recording: studies of many knees, and what they rest on."""
