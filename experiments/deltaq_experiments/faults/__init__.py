"""What a cell keeps when something fails: a catalogue of faults, injected in virtual time or live, and their table."""
