"""The High-Level Interface: it serves controllers, and is the only path from them to the gate."""
