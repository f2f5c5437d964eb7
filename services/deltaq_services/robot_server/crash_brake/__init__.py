"""The process beside a Robot Server that brakes its robot as certified should the Robot Server die.

Left empty on purpose: that process imports from here, and loads neither numpy nor zenoh.
"""
