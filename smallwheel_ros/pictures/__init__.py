"""Pictures; each function returns a matplotlib figure or writes one file."""
