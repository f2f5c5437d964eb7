"""Modes to drive a redundant robot by hand: the control modes of Hooper & Noakes, Table 1.

Each mode turns an operator's command into joint motion; `teleoperator.Teleoperator` is the controller around them.
"""
