"""What an installation is made of: the cells that ship, the launcher, the `deltaq` command, the files of a KRC."""
