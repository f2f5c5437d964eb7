"""A robot driven for an operator who sits elsewhere: what the operator wishes comes in lines, from a console."""
