"""The camera follower of Bjerkeng et al.: the paper's law, its variants, and the quadratic programme."""
