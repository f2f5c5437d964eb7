"""Modes to drive a redundant robot by hand: the control modes of Hooper & Noakes, Table 1.

Each mode turns an operator's present command into joint motion; `switch.Teleoperator` is the controller around them.
"""
