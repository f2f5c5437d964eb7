"""An emulated KUKA robot controller (KRC) that speaks RSI over UDP as the real one does, and its faults."""
