"""Robot models that come with deltaq: one folder a robot, with its URDF and its meshes."""
