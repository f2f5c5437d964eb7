"""The recorder: writes the messages of a cell to an MCAP file, in a separate process."""
