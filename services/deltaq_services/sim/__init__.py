"""The System Integrity Module: the gate, which admits an increment only with a certified brake."""
