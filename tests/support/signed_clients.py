"""Operators and controllers of the small cell, with identities."""

from pathlib import Path

from identities import make

from deltaq_protocol.certified.certificate import certificate_in, now_utc
from deltaq_services.hli.authentication import ClientIdentities

PEOPLE = ("operator-desk", "controller-tower")


def people(to: Path, **options) -> Path:
    """Their folders, and those of the services."""
    return make(to, "small", people=PEOPLE, **options)


def known_to(folder: Path, now=now_utc) -> ClientIdentities:
    """What an HLI knows that has an identity of the same authority."""
    return ClientIdentities(certificate_in(authority_pem(folder).encode(), "authority"), now)


def authority_pem(folder: Path) -> str:
    return (folder / "hli" / "authority.pem").read_text(encoding="ascii")
