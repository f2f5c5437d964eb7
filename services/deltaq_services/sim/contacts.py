"""Contacts: pairs of bodies that an operator lets touch for a while."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from deltaq_cell.description import ContactDescription
from deltaq_cell.proximity import ProximityEngine


class Contacts:
    """Which contacts of a cell are allowed now; none at the start.

    Args:
        proximity: of the cell; it measures no pair that an allowed contact names.
        contacts: of the cell, by name.

    Attributes:
        allowed: names of those that are allowed now, in the cell's order.
    """

    def __init__(self, proximity: ProximityEngine, contacts: Mapping[str, ContactDescription]) -> None:
        self._proximity = proximity
        self._contacts = contacts
        self.allowed: tuple[str, ...] = ()

    def __contains__(self, name: object) -> bool:
        """Whether the cell has such a contact."""
        return name in self._contacts

    def allow(self, names: Iterable[str]) -> None:
        """Allow these contacts and forbid all others."""
        wanted = set(names)
        for contact in self._contacts.values():
            self._proximity.leave_out(contact.pairs, left_out=False)
        self.allowed = tuple(name for name in self._contacts if name in wanted)
        for name in self.allowed:
            self._proximity.leave_out(self._contacts[name].pairs)

    def switch(self, name: str, allowed: bool) -> None:
        """Allow one contact, or forbid it."""
        self.allow({*self.allowed, name} if allowed else {*self.allowed} - {name})

    def speed(self, robot: str) -> tuple[float, str]:
        """Fraction of its velocity limits that a robot may use now, and the contact that sets it, "" if none does."""
        shares = [
            (self._contacts[name].speed, name)
            for name in self.allowed
            if self._contacts[name].concerns(robot)
        ]
        return min(shares, default=(1.0, ""))
