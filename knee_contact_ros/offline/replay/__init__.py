"""A bag over real topics."""
