"""The identity of a cell: its name and a hash of its description, which two processes compare."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CellIdentity:
    """Name and hash of a cell, as a process has read it; as text `NAME CONTENT-BODIES`.

    Attributes:
        name: of the cell.
        content: hash of its description, sixteen hexadecimal digits; empty: unknown.
        bodies: hash of the bodies of its robots; empty for a Robot Server, which reads none.
    """

    name: str
    content: str
    bodies: str = ""

    @classmethod
    def parse(cls, text: str) -> CellIdentity:
        """From any text, so that an unknown text gives an identity too, which differs from all others."""
        name, _, hashes = text.partition(" ")
        content, _, bodies = hashes.partition("-")
        return cls(name, content, bodies)

    def is_same(self, other: CellIdentity) -> bool:
        """Whether both identify one cell, as far as both have read it."""
        bodies_differ = bool(self.bodies and other.bodies) and self.bodies != other.bodies
        return (self.name, self.content) == (other.name, other.content) and not bodies_differ

    def __str__(self) -> str:
        hashes = f"{self.content}-{self.bodies}" if self.bodies else self.content
        return f"{self.name} {hashes}"


def mismatch(who: str, theirs: CellIdentity, ours: CellIdentity) -> str:
    """The message about two processes that have read different cells."""
    told = str(theirs) if theirs.content else f"{theirs.name or 'one'} of a version without a hash"
    return f"{who} has read cell {told.strip()}, and here it is {ours}"
