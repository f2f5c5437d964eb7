"""zenoh sessions of the guarded realm: over TLS where the cell's file says so, and then each heard by its name."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from deltaq_cell.description import CellDescription
from deltaq_protocol.access import access
from deltaq_protocol.certified.encryption import is_encrypted
from deltaq_protocol.certified.names import CLIENT_IDENTITY, IDENTITY
from deltaq_protocol.sayings import speakers_to
from deltaq_protocol.session import open_session
from deltaq_protocol.topic import Party, Realm
from deltaq_services.guarded_key import GuardedKeyError


def open_guarded_session(
    cell: CellDescription,
    party: Party,
    service: str,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    robot: str = "*",
) -> Any:
    """The session of a service.

    Args:
        cell: the cell.
        party: what the service is in the table of topics.
        service: its name.
        listen: endpoints to listen on.
        connect: endpoints to connect to, for ever.
        robot: the only robot that it serves; `*`: all.

    Raises:
        GuardedKeyError: an endpoint uses TLS, and there is no identity.
        IdentityError: the identity belongs to another service, or is not valid.
        ServiceUnreachableError: the session cannot listen on an endpoint.
    """
    tls = service_tls(cell, [*listen, *connect], os.environ.get(IDENTITY), service)
    speakers = None if tls is None else speakers_to(service, cell.cell, tuple(cell.robots))
    rules = access(party, Realm.GUARDED, cell.cell, robot, speakers)
    return open_session(listen=listen, connect=connect, access=rules, tls=tls)


def open_watching_session(cell: CellDescription, connect: Sequence[str], watched: str = "") -> Any:
    """A session that only listens, under the identity of the watched service, or any other identity of the environment.

    Raises:
        GuardedKeyError: an endpoint uses TLS, and there is no identity.
        IdentityError: the identity is not valid.
        ServiceUnreachableError: no service answers there.
    """
    folder = os.environ.get(IDENTITY) or os.environ.get(CLIENT_IDENTITY)
    return open_session(connect=connect, must_connect=True, tls=service_tls(cell, connect, folder, watched))


def service_tls(
    cell: CellDescription, endpoints: Sequence[str], folder: str | None, service: str
) -> dict[str, Any] | None:
    """The certificates of a service's session, as zenoh's configuration has them; None if no endpoint is of TLS.

    Raises:
        GuardedKeyError: an endpoint uses TLS, and no folder is given.
        IdentityError: the identity there belongs to another service or cell, or is not valid.
    """
    encrypted = [text for text in endpoints if is_encrypted(text)]
    if not encrypted:
        return None
    if not folder:
        raise GuardedKeyError(
            f"{encrypted[0]} of cell {cell.cell} is encrypted, and {IDENTITY} names no identity; "
            "make them with `deltaq keys CELL --to FOLDER`"
        )
    from deltaq_services.service_identity import tls_settings

    return tls_settings(cell, Path(folder), service)
