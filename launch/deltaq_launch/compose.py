"""Writes `deploy/compose.yaml` from the table of services: `python -m deltaq_launch.compose`.

With the name or the file of a cell it prints that cell's instead.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import yaml

from deltaq_cell.find import find_cell
from deltaq_cell.load import load_cell
from deltaq_launch.services import (
    GUARDED_ROLES,
    Role,
    Service,
    cell_services,
    console_service,
    demo_controllers,
    metrics_exporter,
)
from deltaq_services.guarded_key import KEY_FILE, off_loopback
from deltaq_services.hli.audit_file import audit_file_name
from deltaq_services.hli.client_tokens import CONTROLLER_TOKEN, OPERATOR_TOKEN
from deltaq_services.process import AUDIT_FILE

FILE = Path(__file__).parents[2] / "deploy" / "compose.yaml"
CELL = "lab"
HEADER = """\
# The lab cell in containers: the services of `deltaq up`, with `--profile demo` the controllers of `deltaq demo`,
# with `--profile metrics` what Prometheus reads. Written by `make docs` from deltaq_launch.services; do not edit.
#
#   make image                                              build the image
#   docker compose -f deploy/compose.yaml up --wait         the emulated cell
#   docker compose -f deploy/compose.yaml up --wait hli     the same without emulators: real robots
"""


CONSOLE_TOKEN = "DELTAQ_CONSOLE_TOKEN"
_SECRET = "deltaq-guarded-key"
KEY_MAKER = "guarded-key"
"""The service that makes the guarded realm's key for the others, if it is not there yet."""
_KEY_VOLUME, _KEY_FOLDER = "guarded", "/run/deltaq"
_AUDIT_VOLUME, _AUDIT_FOLDER = "audit", "/var/lib/deltaq"


def compose_document(cell_name: str = CELL) -> dict[str, Any]:
    """The compose document of a cell: one container a service.

    Those that speak in the guarded realm share its key. On the loopback the first container makes it, in a volume of
    theirs; where the realm leaves the loopback, it is a secret that the user gives.
    """
    cell = load_cell(cell_name)
    services = cell_services(cell, cell_name)
    services = (*services, console_service(cell, cell_name, services))
    document: dict[str, Any] = {service.name: _container(service, cell_name) for service in services}
    for controller in demo_controllers(cell):
        # numba writes to the folder in which it finds machine code
        demo = {"profiles": ["demo"], "tmpfs": ["/tmp"]}
        document[controller.name] = _container(controller, cell_name) | demo
    exporter = metrics_exporter(cell_name)
    document[exporter.name] = _container(exporter, cell_name) | {"profiles": ["metrics"]}
    hli = document["hli"]
    hli["environment"][AUDIT_FILE] = f"{_AUDIT_FOLDER}/{audit_file_name(cell.cell)}"
    hli["volumes"] = [*hli.get("volumes", []), f"{_AUDIT_VOLUME}:{_AUDIT_FOLDER}"]
    guarded = [document[service.name] for service in services if service.role in GUARDED_ROLES]
    if off_loopback(cell) is None:
        file = f"{_KEY_FOLDER}/guarded.key"
        for container in guarded:
            container["environment"] = container.get("environment", {}) | {KEY_FILE: file}
            container["volumes"] = [*container.get("volumes", []), f"{_KEY_VOLUME}:{_KEY_FOLDER}:ro"]
            made = {KEY_MAKER: {"condition": "service_completed_successfully"}}
            container["depends_on"] = made | container.get("depends_on", {})
        maker = _HARDENED | {
            "command": ["deltaq", "key", file, "--keep"],
            "network_mode": "none",
            "volumes": [f"{_KEY_VOLUME}:{_KEY_FOLDER}"],
        }
        return {
            "name": "deltaq",
            "services": {KEY_MAKER: maker} | document,
            "volumes": {_KEY_VOLUME: {}, _AUDIT_VOLUME: {}},
        }
    for container in guarded:
        container["environment"] = container.get("environment", {}) | {KEY_FILE: f"/run/secrets/{_SECRET}"}
        container["secrets"] = [_SECRET]
    needed = f"name a file made with `deltaq key` in {KEY_FILE}"
    secret = {"file": f"${{{KEY_FILE}:?{needed}}}"}  # compose refuses to start anything without it
    return {
        "name": "deltaq",
        "services": document,
        "volumes": {_AUDIT_VOLUME: {}},
        "secrets": {_SECRET: secret},
    }


def compose_text(cell_name: str = CELL) -> str:
    """The same as YAML, with its header."""
    return HEADER + yaml.dump(compose_document(cell_name), Dumper=_Indented, sort_keys=False)


class _Indented(yaml.SafeDumper):
    """Indents lists below their key, as compose files have them, and writes none twice as an alias."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:  # noqa: ARG002 # PyYAML asks
        super().increase_indent(flow, indentless=False)

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002 # PyYAML asks
        return True


_HARDENED: dict[str, Any] = {
    "image": "deltaq",
    "pull_policy": "never",  # `make image` makes it
    "read_only": True,
    "cap_drop": ["ALL"],
    "security_opt": ["no-new-privileges:true"],
}


def _container(service: Service, cell_name: str) -> dict[str, Any]:
    container = _HARDENED | {
        "command": ["python", *service.arguments],
        # RSI counts single milliseconds, and a KRC on the plant's network sends to this host's address
        "network_mode": "host",
        "restart": "unless-stopped",
    }
    if Path(cell_name).is_absolute():
        container["volumes"] = [f"{cell_name}:{cell_name}:ro"]
    if service.role in (Role.EMULATOR, Role.ROBOT_SERVER, Role.SIM, Role.HLI):
        container["cap_add"] = ["SYS_NICE"]  # for real-time priority
    if service.needs:
        container["depends_on"] = {name: {"condition": "service_healthy"} for name in service.needs}
    if service.probe is not None:
        container["healthcheck"] = {
            "test": ["CMD", "deltaq", "health", service.name, "--cell", cell_name],
            # each costs half a second of a core
            "interval": "10s",
            "timeout": "10s",
            "retries": 3,
            "start_period": "60s",
        }
    if service.role is Role.HLI:
        container["environment"] = {
            OPERATOR_TOKEN: f"${{{OPERATOR_TOKEN}:-}}",
            CONTROLLER_TOKEN: f"${{{CONTROLLER_TOKEN}:-}}",
        }
    if service.role is Role.CONSOLE:
        # numba writes to the folder in which it finds machine code
        container["tmpfs"] = ["/tmp"]
        container["environment"] = {
            CONSOLE_TOKEN: f"${{{CONSOLE_TOKEN}:-}}",
            OPERATOR_TOKEN: f"${{{OPERATOR_TOKEN}:-}}",
        }
    return container


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print(compose_text(str(find_cell(sys.argv[1]).resolve())), end="")
    else:
        FILE.write_text(compose_text(), encoding="utf-8")
