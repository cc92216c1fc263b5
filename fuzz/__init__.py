"""Inputs that nobody intended, by the hundred thousand: `make fuzz`."""
