"""Exit statuses of deltaq's programs. Imports nothing: it is read before anything can fail."""

DONE = 0
BAD = 1
"""The thing reported is bad, was refused, or broke."""
USAGE = 2
"""Wrong usage or configuration."""
UNREACHABLE = 3
"""A service did not answer."""
INTERRUPTED = 130
"""What a shell gives to a program that Ctrl-C ended."""
