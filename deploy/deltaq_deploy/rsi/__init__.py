"""First contact with a KRC: listen to its telegrams, or answer them with no correction, and report statistics."""
