"""What starts things: the table of services, the launcher, and a connection to the cell that runs."""
