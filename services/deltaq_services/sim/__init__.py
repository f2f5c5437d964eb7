"""The System Integrity Module: the gate that admits only what can still be braked."""
