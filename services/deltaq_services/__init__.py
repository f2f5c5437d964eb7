"""The processes of the guarded realm, one folder each: HLI, SIM and Robot Server."""
