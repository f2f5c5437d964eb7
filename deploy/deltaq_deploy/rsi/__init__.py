"""First contact with a KRC: listen to its telegrams, or answer them with no correction, and say what was seen."""
