"""An operator's commands, cycle by cycle: from a device, a script, a master arm, or on the path to an option."""
