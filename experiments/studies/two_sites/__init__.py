"""A cell on two sites and controllers far away, over real processes and in virtual time."""
