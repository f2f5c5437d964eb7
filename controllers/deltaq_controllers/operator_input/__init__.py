"""What an operator wishes, cycle by cycle: from a keyboard, a gamepad, a script, or by going to an option."""
