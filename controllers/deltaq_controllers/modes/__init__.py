"""Ways to drive a redundant robot by hand: the control modes of Hooper & Noakes, Table 1.

Each mode turns what an operator wishes now into joint motion; `switch.Teleoperator` is the controller around them.
"""
