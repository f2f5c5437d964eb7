"""The table of faults over real processes: the evidence behind `docs/notes/fault-table.md`."""
