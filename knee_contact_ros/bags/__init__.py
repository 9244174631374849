"""Reading, writing and recovery of recordings."""
