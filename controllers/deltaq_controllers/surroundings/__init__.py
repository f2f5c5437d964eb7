"""Surroundings of a robot: distances, their Jacobians, predicted positions of other robots, and barriers."""
