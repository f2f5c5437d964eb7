"""zenoh sessions of the guarded realm: over Unix sockets on one machine, over mutual TLS on several.

On one machine the sockets lie in a folder of mode 0700, so that the kernel lets no other user connect. On several each
service has a certificate, and zenoh's access control accepts its messages only under the keys that the table of
topics allows.
"""

import os
from collections.abc import Sequence
from hashlib import blake2b
from pathlib import Path
from typing import Any

from deltaq_cell.description import CellDescription
from deltaq_cell.guarded_endpoints import (
    GuardedEndpoint,
    guarded_endpoints,
    guarded_fault,
    is_on_one_machine,
    socket_name,
)
from deltaq_protocol.access import access
from deltaq_protocol.certified.names import CLIENT_IDENTITY, IDENTITY
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.sayings import speakers_to
from deltaq_protocol.session import open_session
from deltaq_protocol.topic import Party, Realm
from deltaq_services.runtime_folder import private_folder, runtime_folder

GUARDED_FOLDER = "DELTAQ_GUARDED_FOLDER"
"""Environment variable: folder of the sockets, in place of one in the user's runtime folder."""

_MOST_PATH_BYTES = 100
"""The kernel allows 107, and zenoh locks a file of a longer name beside the socket."""


class GuardedRealmError(DeltaqError):
    """An endpoint is open to other users, or an identity is missing."""


def realm_of(cell: CellDescription) -> str | None:
    """The name of a cell's folder of sockets, one for each place at which its HLI listens; None on several machines."""
    if not is_on_one_machine(cell):
        return None
    place = f"{cell.hli} {cell.tcp_address} {cell.tcp_port}"
    return f"{cell.cell[:32]}-{blake2b(place.encode(), digest_size=4).hexdigest()}"


def guarded_folder(realm: str) -> Path:
    """The folder of a realm's sockets, made if need be.

    Raises:
        RuntimeFolderError: it cannot be made, another user owns it, or others may read or write it.
    """
    if given := os.environ.get(GUARDED_FOLDER):
        return private_folder(Path(given), f"let {GUARDED_FOLDER} name a folder of your own")
    return private_folder(runtime_folder() / realm, "remove it")


def guarded_links(cell: CellDescription) -> dict[str, str]:
    """The endpoint of each service of a cell, in zenoh's form.

    Raises:
        GuardedRealmError: an endpoint is open to other users, or the path of a socket is too long.
        RuntimeFolderError: the folder of the sockets is not this user's alone.
    """
    if (fault := guarded_fault(cell)) is not None:
        raise GuardedRealmError(f"{fault[0].place} of cell {cell.cell}: {fault[1]}")
    realm = realm_of(cell)
    folder = None if realm is None else guarded_folder(realm)
    return {each.service: _link(each, folder) for each in guarded_endpoints(cell)}


def _link(endpoint: GuardedEndpoint, folder: Path | None) -> str:
    name = socket_name(endpoint)
    if folder is None or name is None:
        return endpoint.text
    path = str(folder / name)
    if len(path.encode()) > _MOST_PATH_BYTES:
        raise GuardedRealmError(
            f"{path} has {len(path.encode())} bytes, and the path of a Unix socket at most {_MOST_PATH_BYTES}; "
            f"let {GUARDED_FOLDER} name a shorter folder"
        )
    return f"unixsock-stream/{path}"


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
        party: role of the service in the table of topics.
        service: its name.
        listen: services whose endpoints it listens at: none, or itself.
        connect: services to connect to; lost connections are made again.
        robot: the only robot that it serves; `*`: all.

    Raises:
        GuardedRealmError: an endpoint is open to other users, or uses TLS and there is no identity.
        IdentityError: the identity belongs to another service, or is not valid.
        RuntimeFolderError: the folder of the sockets is not this user's alone.
        ServiceUnreachableError: the session cannot listen on an endpoint.
    """
    links = guarded_links(cell)
    here, there = [links[name] for name in listen], [links[name] for name in connect]
    tls = service_tls(cell, [*here, *there], os.environ.get(IDENTITY), service)
    speakers = None if tls is None else speakers_to(service, cell.cell, tuple(cell.robots))
    rules = access(party, Realm.GUARDED, cell.cell, robot, speakers)
    return open_session(listen=here, connect=there, access=rules, tls=tls)


def open_watching_session(cell: CellDescription, watched: str, others: Sequence[str] = ()) -> Any:
    """A session that only listens, under the identity of the watched service, or any other identity of the environment.

    Args:
        cell: the cell.
        watched: the service to connect to.
        others: further endpoints to connect to.

    Raises:
        GuardedRealmError: an endpoint is open to other users, or uses TLS and there is no identity.
        IdentityError: the identity is not valid.
        RuntimeFolderError: the folder of the sockets is not this user's alone.
        ServiceUnreachableError: no service answers there.
    """
    connect = [guarded_links(cell)[watched], *others]
    folder = os.environ.get(IDENTITY) or os.environ.get(CLIENT_IDENTITY)
    tls = service_tls(cell, connect, folder, watched, only_watches=True)
    return open_session(connect=connect, must_connect=True, tls=tls)


def service_tls(
    cell: CellDescription,
    endpoints: Sequence[str],
    folder: str | None,
    service: str,
    only_watches: bool = False,
) -> dict[str, Any] | None:
    """The certificates of a service's session, as zenoh's configuration has them; None if no endpoint is of TLS.

    A session that `only_watches` may show any identity of the cell.

    Raises:
        GuardedRealmError: an endpoint uses TLS, and no folder is given.
        IdentityError: the identity there belongs to another service or cell, or is not valid.
    """
    encrypted = [text for text in endpoints if text.startswith("tls/")]
    if not encrypted:
        return None
    if not folder:
        raise GuardedRealmError(
            f"{encrypted[0]} of cell {cell.cell} is encrypted, and {IDENTITY} names no identity; "
            "make them with `deltaq keys --cell CELL --output FOLDER`"
        )
    from deltaq_services.service_identity import tls_settings

    return tls_settings(cell, Path(folder), service, only_watches)
