"""An operator's commands, cycle by cycle: from a keyboard, a gamepad, a script, or on the path to an option."""
