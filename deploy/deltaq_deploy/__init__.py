"""What an installation is made of: the cells that ship, and the files of a KRC."""
