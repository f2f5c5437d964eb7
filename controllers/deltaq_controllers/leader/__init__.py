"""Leaders for the camera follower's experiments: an operator that steers about, and one that attacks."""
