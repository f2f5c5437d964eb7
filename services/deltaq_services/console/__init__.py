"""The operator's console in a browser; a client of the HLI like any other."""
