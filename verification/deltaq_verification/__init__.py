"""What verifies: the virtual cell, faults, impaired wires, the model checker, attacks and replay."""
