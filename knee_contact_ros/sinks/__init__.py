"""Where answers go: each in a process of its own."""
