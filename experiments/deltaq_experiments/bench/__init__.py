"""Figures as ratios, each against its reference in the same run: `deltaq bench`."""
