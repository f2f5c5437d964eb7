"""Closed-form inverse kinematics: every branch of an arm, for many poses at once."""
