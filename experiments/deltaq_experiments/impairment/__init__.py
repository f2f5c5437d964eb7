"""Faults of a wire between two processes, put there by a relay between them: seeded, in user space."""
