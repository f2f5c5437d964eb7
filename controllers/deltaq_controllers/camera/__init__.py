"""The camera follower of Bjerkeng et al.: the paper's law, and the quadratic programme."""

FOLLOWS = "qp"
"""Name of the default camera controller of the demonstration and the console."""
