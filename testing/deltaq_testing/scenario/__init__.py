"""Scenarios: faults for a controller, and what must come of them, as a file."""
