"""When the contact force can drop in osteoarthritis: 10 000 knees, load or height prescribed."""
