"""What assistance at the knee does to the estimated load and the contact: `python -m studies.assistance`."""
