"""Identities of a cell's services, operators and controllers: a key each, and the certificate of the cell's authority.

It needs the package `cryptography` (`deltaq[identity]`); a client that shows a token, or nothing, does not need it.
"""
