"""Long proofs of gate, brake, phases and services: programs that the tests run, and people in a clone."""
