"""Scenarios: faults for a controller, and the expected results, as a file."""
