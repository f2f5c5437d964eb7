"""The camera follower of Bjerkeng et al.: the paper's law, and the quadratic programme."""

FOLLOWS = "qp"
"""Name of the controller that follows where nobody names another: in the demonstration, and at the console."""
