"""The operator's console: what an operator sees and holds, in a browser; a client of the HLI like any other."""
