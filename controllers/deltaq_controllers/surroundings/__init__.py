"""What is near a robot: distances, how the joints change them, where the other robots will be, and barriers to keep."""
