"""Which limits a cell keeps when something fails: a catalogue of faults, in virtual time or live, and their table."""
