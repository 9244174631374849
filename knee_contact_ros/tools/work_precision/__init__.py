"""`knee-contact trade`: what precision costs here and with what a user would take instead, in one run."""
