"""Controllers: clients of the HLI like any other."""
