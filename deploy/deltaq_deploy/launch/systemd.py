"""Writes systemd units from the table of services: `python -m deltaq_deploy.launch.systemd CELL --to FOLDER [--real]`.

`make docs` writes those of the emulated lab cell to `deploy/systemd` with it.
"""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path

from deltaq_cell.find import find_cell
from deltaq_cell.load import load_cell
from deltaq_deploy.launch.child_process import NICENESS
from deltaq_deploy.launch.services import (
    GUARDED_ROLES,
    RESOURCES,
    Role,
    Service,
    cell_services,
    console_service,
    metrics_exporter,
    select,
)
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.heartbeat import PERIOD_S
from deltaq_services.console.settings import CONSOLE_TOKEN
from deltaq_services.guarded_realm import GUARDED_FOLDER
from deltaq_services.process import AUDIT_FILE

USER = "deltaq"
TARGET = "deltaq.target"
RUN_FOLDER = "deltaq"
"""Of /run: HLI, SIM and Robot Servers meet there."""
CONSOLE_FOLDER = "deltaq-console"
"""Of /run: the console's token is there for as long as the console is up."""
SETTINGS = "/etc/deltaq/deltaq.env"
"""File for environment variables of the services, such as tokens' files."""
STOPS_WITHIN_S = 20
"""Longer than a robot brakes, and than the process takes that brakes it in its Robot Server's stead."""
_STARTS_WITHIN_S = 300
_SILENT_BEATS = 10

Lines = list[str]

_DESCRIPTIONS = {
    Role.ROBOT_SERVER: "Robot Server",
    Role.EMULATOR: "emulated controller",
    Role.SIM: "gate",
    Role.HLI: "high-level interface",
    Role.CONSOLE: "console",
    Role.METRICS: "metrics for Prometheus",
}
_OPEN_FILES = 16_384
_HARDENED = """\
User=deltaq
Group=deltaq
UMask=0077
NoNewPrivileges=yes
CapabilityBoundingSet=
AmbientCapabilities=
ProtectSystem=strict
ProtectHome={home}
PrivateTmp=yes
PrivateDevices=yes
ProtectClock=yes
ProtectControlGroups=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
ProtectProc=invisible
RemoveIPC=yes
RestrictAddressFamilies=AF_INET AF_INET6 AF_NETLINK AF_UNIX
RestrictNamespaces=yes
RestrictRealtime={no_real_time}
RestrictSUIDSGID=yes
LockPersonality=yes
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallErrorNumber=EPERM
"""


def name_of(service: Service) -> str:
    """The unit of a service."""
    return f"deltaq-{service.name}.service"


def unit(service: Service, cell_name: str, python: Path, here: Iterable[Service]) -> str:
    """The unit that runs a service of a cell.

    Args:
        service: the service.
        cell_name: the cell's, or the absolute path of its file.
        python: the interpreter that has deltaq installed.
        here: all services that this machine runs.
    """
    names = {other.name for other in here}
    needs = [f"deltaq-{name}.service" for name in service.needs if name in names]
    of = f" of {service.robot}" if service.robot else ""
    lines = [
        "[Unit]",
        f"Description=deltaq {_DESCRIPTIONS[service.role]}{of}, cell {Path(cell_name).stem}",
        "Documentation=man:systemd.service(5)",
        f"PartOf={TARGET}",
        "Wants=network-online.target",
        # units stop in reverse order: the Robot Servers last, once their robots rest
        " ".join(["After=network-online.target", *needs]),
        *([f"Wants={' '.join(needs)}"] if needs else []),
        "",
        "[Service]",
        *_life(service),
        *_token(service, python),
        f"ExecStart={' '.join((str(python), *service.arguments))}",
        *_environment(service),
        *_limits(service.role),
        *_hardened(service.role, cell_name),
        "",
        "[Install]",
        f"WantedBy={TARGET}",
    ]
    return "\n".join(lines) + "\n"


def target(services: Iterable[Service]) -> str:
    """The target of a whole cell."""
    wants = " ".join(name_of(service) for service in services)
    return f"[Unit]\nDescription=deltaq cell\nWants={wants}\n\n[Install]\nWantedBy=multi-user.target\n"


def _life(service: Service) -> Lines:
    lines = [
        # a service with a health gives signs of life; see deltaq_protocol.heartbeat
        f"Type={'exec' if service.probe is None else 'notify'}",
        f"TimeoutStartSec={_STARTS_WITHIN_S}",
        f"TimeoutStopSec={STOPS_WITHIN_S}",
        # to all processes SIGTERM, and none is killed while a robot brakes: the one beside a Robot Server ignores it
        "KillMode=control-group",
        "Restart=always",
        "RestartSec=2",
        "RestartPreventExitStatus=2",  # the configuration is wrong, and will be the next time
    ]
    if service.probe is not None and service.role is not Role.SIM:  # the gate depends on its messages
        lines.append(f"WatchdogSec={PERIOD_S * _SILENT_BEATS:g}")
    return lines


def _token(service: Service, python: Path) -> Lines:
    """Of the console, which would command for every user of the machine where the settings give it the operator's."""
    if service.role is not Role.CONSOLE:
        return []
    file = f"/run/{CONSOLE_FOLDER}/console.token"
    return [
        f"RuntimeDirectory={CONSOLE_FOLDER}",
        "RuntimeDirectoryMode=0700",
        "RuntimeDirectoryPreserve=restart",
        f"Environment={CONSOLE_TOKEN}_FILE={file}",
        # a key's digits are as good a token
        f"ExecStartPre={python.parent / 'deltaq'} keys --secret --keep --output {file}",
    ]


def _environment(service: Service) -> Lines:
    lines = [
        "Environment=PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1 XDG_CACHE_HOME=/var/cache",
        "CacheDirectory=deltaq",  # numba's machine code
    ]
    if service.role in GUARDED_ROLES and service.realm is not None:
        lines += [
            f"Environment={GUARDED_FOLDER}=/run/{RUN_FOLDER}",
            f"RuntimeDirectory={RUN_FOLDER}",
            "RuntimeDirectoryMode=0700",
            "RuntimeDirectoryPreserve=yes",  # the other services are still in it
        ]
    if service.role is Role.HLI:
        lines += [
            f"Environment={AUDIT_FILE}=/var/lib/deltaq/audit.jsonl",
            "StateDirectory=deltaq",
            "StateDirectoryMode=0700",
        ]
    return [*lines, f"EnvironmentFile=-{SETTINGS}"]


def _limits(role: Role) -> Lines:
    resources = RESOURCES[role]
    lines = [
        f"MemoryMax={resources.memory_mb}M",
        "MemorySwapMax=0",  # a cycle does not wait for a disk
        f"TasksMax={resources.tasks}",
        f"CPUQuota={resources.cores * 100:g}%",
        # zenoh locks its shared memory, and a session without that right does not open
        f"LimitMEMLOCK={resources.memory_mb}M",
    ]
    if role is Role.HLI:
        lines.append(f"LimitNOFILE={_OPEN_FILES}")
    if resources.real_time:
        lines += [
            f"LimitRTPRIO={resources.real_time}",
            f"Nice={NICENESS}",
        ]
    return lines


def _hardened(role: Role, cell_name: str) -> Lines:
    # a cell's file in a user's home has to be read
    home = "read-only" if cell_name.startswith(("/home/", "/root/", "/run/user/")) else "yes"
    no_real_time = "no" if RESOURCES[role].real_time else "yes"
    return _HARDENED.format(home=home, no_real_time=no_real_time).splitlines()


CELL = "lab"
PYTHON = Path("/opt/deltaq/bin/python")
HEADER = (
    "# Written by `python -m deltaq_deploy.launch.systemd` from deltaq_deploy.launch.services; do not edit.\n"
)


def units(
    cell_name: str = CELL, real: bool = False, python: Path = PYTHON, only: Sequence[str] = ()
) -> dict[str, str]:
    """The units of a cell by file name: one a service, and a target for all.

    Args:
        cell_name: the name of the cell, or the absolute path of its file.
        real: the robots are real, so there is no emulator.
        python: the interpreter that has deltaq installed.
        only: names or roles of the services that this machine runs; empty for all.

    Raises:
        DeltaqError: if there is no such cell or service.
    """
    services = _services(cell_name, real)
    chosen = select(services, only) if only else services
    texts = {name_of(service): unit(service, cell_name, python, chosen) for service in chosen}
    # metrics are for Prometheus: the unit exists, and is started on demand
    texts[TARGET] = target(service for service in chosen if service.name != "metrics" or only)
    return {name: HEADER + text for name, text in sorted(texts.items())}


def write(texts: dict[str, str], folder: Path) -> None:
    """Write the units to a folder, in the place of all that are there."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("deltaq*"):
        if old.read_text(encoding="utf-8").startswith(HEADER):
            old.unlink()
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


def _services(cell_name: str, real: bool) -> tuple[Service, ...]:
    cell = load_cell(cell_name)
    services = cell_services(cell, cell_name, real)
    return (*services, console_service(cell, cell_name, services), metrics_exporter(cell_name))


def main(argv: Sequence[str] | None = None) -> None:
    """Write units."""
    parser = argparse.ArgumentParser(
        prog="python -m deltaq_deploy.launch.systemd", description="systemd units of a cell"
    )
    parser.add_argument("cell", help="name or YAML file of the cell")
    parser.add_argument("--to", type=Path, metavar="FOLDER", required=True, help="folder to write them to")
    parser.add_argument("--real", action="store_true", help="real robots: no emulator")
    parser.add_argument(
        "--python", type=Path, default=PYTHON, help="that has deltaq installed (default: %(default)s)"
    )
    parser.add_argument(
        "--only", default="", help="services or kinds that this machine runs, e.g. robot-server,sim"
    )
    given = parser.parse_args(argv)
    only = [name.strip() for name in given.only.split(",") if name.strip()]
    try:
        file = find_cell(given.cell)
        shipped = given.cell if not Path(given.cell).exists() else str(file.resolve())
        write(units(shipped, given.real, given.python, only), given.to)
    except DeltaqError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"--to {given.to}: {error.filename} cannot be written: {error.strerror}")


if __name__ == "__main__":
    main()
