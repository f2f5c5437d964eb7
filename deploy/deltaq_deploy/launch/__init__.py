"""What starts things: the table of services, the launcher, and a connection to the cell that runs.

Here are the exit statuses of deltaq's programs. Nothing is imported: they are read before anything can fail.
"""

DONE = 0
BAD = 1
"""The thing reported is bad, was refused, or broke."""
USAGE = 2
"""Wrong usage or configuration."""
UNREACHABLE = 3
"""A service did not answer."""
INTERRUPTED = 130
"""What a shell gives to a program that Ctrl-C ended."""
