"""Faults of a link between two processes, put there by a relay between them: seeded, in user space."""
