"""Identities of a cell, as `deltaq keys` makes them."""

from datetime import timedelta
from pathlib import Path

from deltaq_protocol.certified.authority import make_identities
from deltaq_protocol.certified.certificate import now_utc
from deltaq_protocol.sayings import services

ROBOTS = ("fr", "gr")


def make(to: Path, cell="lab", robots=ROBOTS, people=(), age=timedelta(0), **options) -> Path:
    """Identities that were made some time ago."""
    make_identities(cell, to, services(robots), people, now_utc() - age, **options)
    return to
