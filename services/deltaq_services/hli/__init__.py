"""The high-level interface: what controllers talk to, and the only way from them to the gate."""
