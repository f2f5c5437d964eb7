"""The model of a cell: its description, its robots' kinematics, and the proximity between its bodies."""
