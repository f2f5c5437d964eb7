"""The KUKA KR 16, on the floor (`kr16.urdf`) and hanging from a 3-axis gantry (`kr16_gantry.urdf`)."""
