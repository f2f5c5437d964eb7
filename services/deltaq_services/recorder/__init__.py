"""The recorder: keeps what a cell does in an MCAP file, in a process of its own."""
