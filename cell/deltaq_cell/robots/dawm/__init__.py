"""The Dual Arm Work Module: 17 joints, a tree of two chains that share the torso's yaw."""
