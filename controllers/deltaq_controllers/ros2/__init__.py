"""A bridge to ROS 2 that needs no ROS: joint states out, joint trajectories in, as CDR over zenoh.

It is a client like any other: it reads states, and moves a robot by a lease of the open realm, through the gate.
"""
