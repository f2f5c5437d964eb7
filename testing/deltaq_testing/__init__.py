"""Faults for controllers of your own: a cell to test them in, a plug-in of pytest, scenarios and their reports."""
