"""A cell in virtual time, faults for controllers of your own, replay of recordings, scenarios and their reports."""
