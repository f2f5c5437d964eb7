"""The driver process of a robot: takes an operator's commands as lines from a console."""
