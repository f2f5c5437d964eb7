"""The Robot Server: one process a robot, the last program before the drives."""
