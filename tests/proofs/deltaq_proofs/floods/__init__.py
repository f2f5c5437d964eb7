"""What floods at the HLI's ports cost everybody else, in figures."""
