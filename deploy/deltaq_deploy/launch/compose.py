"""Prints the compose file of a cell, by its name or path: `python -m deltaq_deploy.launch.compose CELL`.

`make docs` writes `deploy/compose.yaml` and `deploy/realtime.yaml` with it. `deploy/compose.tokens.yaml` adds to the
first what a cell with `clients_need_tokens` has in it.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from deltaq_cell.description import CellDescription
from deltaq_cell.find import find_cell
from deltaq_cell.load import load_cell
from deltaq_cell.open_realm import is_loopback
from deltaq_deploy.launch.services import (
    GUARDED_ROLES,
    RESOURCES,
    Role,
    Service,
    cell_services,
    console_service,
    demo_controllers,
    metrics_exporter,
)
from deltaq_protocol.certified.names import IDENTITY
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.given_token import CLIENT_TOKEN, OPERATOR_TOKEN
from deltaq_protocol.heartbeat import HEALTH_FILE
from deltaq_protocol.log import FORMAT
from deltaq_services.console.settings import CONSOLE_TOKEN
from deltaq_services.guarded_realm import GUARDED_FOLDER
from deltaq_services.hli.audit import audit_file_name
from deltaq_services.hli.client_roles import CONTROLLER_TOKEN
from deltaq_services.hli.line_encryption import CERTIFICATE_FILE, KEY_FILE
from deltaq_services.process import AUDIT_FILE

USER = 10001
"""User of every container, with no counterpart on the host; in the image its name is `deltaq`."""
_TMP_MB = 128
_HEALTH = "/tmp/health"

HARDENED: dict[str, Any] = {
    "image": "deltaq",
    "pull_policy": "never",  # never an image of that name from a registry
    "user": f"{USER}:{USER}",
    "read_only": True,
    "cap_drop": ["ALL"],
    "security_opt": ["no-new-privileges:true"],
    "logging": {
        "driver": "json-file",
        "options": {"max-size": "10m", "max-file": "3"},
    },  # Podman knows it, too
}


def container(service: Service, cell_name: str) -> dict[str, Any]:
    """A container that runs a service of a cell."""
    command = ["python", *service.arguments]
    if service.role is Role.ROBOT_SERVER:
        # should it die, a process beside it brakes the robot, which the end of the container would kill
        command = ["until-all-ended", *command]
    found = HARDENED | {
        "command": command,
        # RSI counts single milliseconds, and a KRC on the plant's network sends to this host's address
        "network_mode": "host",
        "restart": "unless-stopped",
        "stop_grace_period": "20s",
        # the health file, and the machine code that numba copies to where it can write
        "tmpfs": [f"/tmp:mode=1777,size={_TMP_MB}m"],
        "environment": {FORMAT: f"${{{FORMAT}:-text}}"},
        **_limits(service.role),
    }
    if Path(cell_name).is_absolute():
        found["volumes"] = [f"{cell_name}:{cell_name}:ro"]
    if service.needs:
        found["depends_on"] = {name: {"condition": "service_healthy"} for name in service.needs}
    if service.probe is not None:
        found["environment"][HEALTH_FILE] = _HEALTH
        found["healthcheck"] = {
            "test": ["CMD", "healthy", _HEALTH],
            # a container that depends on a healthy one waits for the next check: engines before 25 have no
            # start_interval
            "interval": "5s",
            "timeout": "5s",
            "retries": 3,
            "start_period": "120s",
        }
    return found


def real_time(service: Service) -> dict[str, Any]:
    """The limit that permits a container real-time priority; empty for a service that never asks.

    Not part of a container, since an engine without the rights of root cannot raise a limit and starts nothing then.
    """
    priority = int(RESOURCES[service.role].real_time)  # a number, not its name
    return {"ulimits": {"rtprio": priority}} if priority else {}


def _limits(role: Role) -> dict[str, Any]:
    resources = RESOURCES[role]
    return {
        "mem_limit": f"{resources.memory_mb}m",
        "memswap_limit": f"{resources.memory_mb}m",  # no swap: a cycle does not wait for a disk
        "pids_limit": resources.tasks,
        "cpus": resources.cores,
    }


CELL = "lab"
HEADER = """\
# The lab cell in containers: the services of `deltaq up`, with `--profile demo` the controllers of `deltaq demo`,
# with `--profile metrics` the exporter for Prometheus. Written by `make docs`; do not edit.
#
#   docker compose -f deploy/compose.yaml up --build --wait   build the image, and the emulated cell
#   docker compose -f deploy/compose.yaml up --wait hli       the same without emulators: real robots
"""
REAL_TIME_HEADER = """\
# Real-time priority for the lab cell in containers, on an engine that may raise limits. Written by `make docs`; do not
# edit.
#
#   docker compose -f deploy/compose.yaml -f deploy/realtime.yaml up --wait
"""

ADDRESS = "address"
"""The service of the demonstration that prints where the console is."""
_GUARDED_VOLUME, _GUARDED_FOLDER = "guarded", "/run/deltaq"
_IDENTITY_FOLDER = "/run/identity"
_AUDIT_VOLUME, _AUDIT_FOLDER = "audit", "/var/lib/deltaq"
_BUILD = {"context": "..", "dockerfile": "deploy/Dockerfile"}

_TOKENS = {
    Role.HLI: (f"{OPERATOR_TOKEN}_FILE", f"{CONTROLLER_TOKEN}_FILE"),
    Role.CONSOLE: (f"{CONSOLE_TOKEN}_FILE", f"{OPERATOR_TOKEN}_FILE"),
}
_CONTROLLER_ROLES = (Role.LEADER, Role.FOLLOWER)
_MAKES_TOKEN = "name a file with a token"
_MAKES = {
    CERTIFICATE_FILE: "name a certificate",
    KEY_FILE: "name the private key of the certificate",
}


def compose_document(cell_name: str = CELL) -> dict[str, Any]:
    """The compose document of a cell: one container a service.

    Those that speak in the guarded realm meet in a volume that no other container has. Tokens and the certificate of
    the lines, where the cell needs them, are secrets that the user gives; so are the services' identities, if the
    guarded realm is on several machines.
    """
    cell = load_cell(cell_name)
    services = _services(cell, cell_name)
    document: dict[str, Any] = {service.name: container(service, cell_name) for service in services}
    document[ADDRESS] = _address(services[-1])
    controllers = demo_controllers(cell)
    # `up --wait` fails on a container that ends, unless another waits for its end
    told = {ADDRESS: {"condition": "service_completed_successfully"}}
    for controller in controllers:
        one = container(controller, cell_name) | {"profiles": ["demo"]}
        document[controller.name] = one | {"depends_on": one["depends_on"] | told}
    exporter = metrics_exporter(cell_name)
    document[exporter.name] = container(exporter, cell_name) | {"profiles": ["metrics"]}
    hli = document["hli"]
    hli["environment"][AUDIT_FILE] = f"{_AUDIT_FOLDER}/{audit_file_name(cell.cell)}"
    hli["volumes"] = [*hli.get("volumes", []), f"{_AUDIT_VOLUME}:{_AUDIT_FOLDER}"]
    volumes: dict[str, Any] = {_AUDIT_VOLUME: {}}
    guarded = [service for service in services if service.role in GUARDED_ROLES]
    for service in guarded:
        one = document[service.name]
        if service.realm is None:
            one["environment"][IDENTITY] = _IDENTITY_FOLDER
            given_folder = f"${{{IDENTITY}:?name the folder that `deltaq keys` wrote}}/{service.name}"
            mounted = f"{given_folder}:{_IDENTITY_FOLDER}:ro"
        else:
            one["environment"][GUARDED_FOLDER] = _GUARDED_FOLDER
            mounted = f"{_GUARDED_VOLUME}:{_GUARDED_FOLDER}"
            volumes = {_GUARDED_VOLUME: {}} | volumes
        one["volumes"] = [*one.get("volumes", []), mounted]
    given: dict[str, Any] = {}
    if cell.clients_need_tokens:
        _give_tokens(document, given, (*services, *controllers))
        if not is_loopback(cell.tcp_address):
            _give(hli, given, CERTIFICATE_FILE, KEY_FILE)
    elif not is_loopback(cell.console_address):
        _give(document["console"], given, f"{CONSOLE_TOKEN}_FILE")
    # all others wait for the first, directly or not, and find its image
    first = next(iter(document))
    document[first] = {"build": _BUILD} | document[first]
    return {"name": "deltaq", "services": document, "volumes": volumes} | (
        {"secrets": given} if given else {}
    )


def real_time_document(cell_name: str = CELL) -> dict[str, Any]:
    """What another compose file adds: the limit with which a service may ask for real-time priority."""
    cell = load_cell(cell_name)
    everybody = (*_services(cell, cell_name), *demo_controllers(cell))
    return {"services": {one.name: real_time(one) for one in everybody if real_time(one)}}


def compose_text(cell_name: str = CELL) -> str:
    """The compose document as YAML, with its header."""
    return HEADER + _yaml(compose_document(cell_name))


def real_time_text(cell_name: str = CELL) -> str:
    """The document of real-time priority as YAML, with its header."""
    return REAL_TIME_HEADER + _yaml(real_time_document(cell_name))


def _services(cell: CellDescription, cell_name: str) -> tuple[Service, ...]:
    services = cell_services(cell, cell_name)
    return (*services, console_service(cell, cell_name, services))


def _give(one: dict[str, Any], given: dict[str, Any], *variables: str) -> None:
    """Give a container secrets, each in a file that the variable names, inside the container and on the host."""
    for variable in variables:
        secret = _secret_of(variable)
        one["environment"][variable] = f"/run/secrets/{secret}"
        one["secrets"] = [*one.get("secrets", []), secret]
        needed = f"{_MAKES.get(variable, _MAKES_TOKEN)} in {variable}"
        given[secret] = {"file": f"${{{variable}:?{needed}}}"}  # compose refuses to start anything without it


def _give_tokens(document: dict[str, Any], given: dict[str, Any], services: Sequence[Service]) -> None:
    """Give each container of a cell with tokens those that it needs, and tell the console's with its address."""
    for service in services:
        _give(document[service.name], given, *_TOKENS.get(service.role, ()))
        if service.role in _CONTROLLER_ROLES:
            secret = _secret_of(f"{CONTROLLER_TOKEN}_FILE")
            document[service.name]["environment"][f"{CLIENT_TOKEN}_FILE"] = f"/run/secrets/{secret}"
            document[service.name]["secrets"] = [secret]
        if service.role is Role.CONSOLE:
            secret = _secret_of(f"{CONSOLE_TOKEN}_FILE")
            told = f"echo the console is at '{service.endpoint}/?token='$$(cat /run/secrets/{secret})"
            document[ADDRESS] |= {"command": ["sh", "-c", told], "secrets": [secret]}


def _secret_of(variable: str) -> str:
    return variable.lower().removesuffix("_file").replace("_", "-")


def _address(console: Service) -> dict[str, Any]:
    return HARDENED | {
        "command": ["echo", f"the console is at {console.endpoint}"],
        "network_mode": "none",
        "mem_limit": "32m",
        "pids_limit": 8,
        "depends_on": {console.name: {"condition": "service_healthy"}},
        "profiles": ["demo"],
    }


def _yaml(document: dict[str, Any]) -> str:
    return yaml.dump(document, Dumper=_Indented, sort_keys=False, width=120)


class _Indented(yaml.SafeDumper):
    """Indents lists below their key, as compose files have them, and writes none twice as an alias."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:  # noqa: ARG002 # PyYAML asks
        super().increase_indent(flow, indentless=False)

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002 # PyYAML asks
        return True


def main(argv: Sequence[str] | None = None) -> None:
    """Print the document of a cell."""
    parser = argparse.ArgumentParser(
        prog="python -m deltaq_deploy.launch.compose", description="compose file of a cell"
    )
    parser.add_argument("cell", help="name or YAML file of the cell, whose document is printed")
    parser.add_argument("--real-time", action="store_true", help="print the overlay for real-time priority")
    given = parser.parse_args(argv)
    try:
        file = find_cell(given.cell)
        cell = str(file.resolve()) if Path(given.cell).exists() else given.cell
        print(real_time_text(cell) if given.real_time else compose_text(cell), end="")
    except DeltaqError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
