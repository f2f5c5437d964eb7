"""Problems of a cell description that show without a model of its robots, also in the files that it names."""

import math
from collections.abc import Collection, Iterator
from pathlib import Path

from deltaq_cell.description import CellDescription, RobotDescription, RsiDescription
from deltaq_cell.drive_lag import REMAINDER, emulated_lag, least_servo_lag_s
from deltaq_cell.find import resolve_near
from deltaq_cell.guarded_endpoints import guarded_endpoints, guarded_fault
from deltaq_cell.krc_files import judge_krc_files
from deltaq_cell.models import nearest_name
from deltaq_cell.open_realm import (
    ALLOWS_ANYBODY,
    CROSSES_IN_CLEAR,
    NEEDS_TOKENS,
    off_loopback,
    zenoh_in_clear,
)
from deltaq_cell.problems import Problem
from deltaq_cell.yaml_tree import FieldPath, PlacedProblems
from deltaq_protocol.endpoint import Endpoint

KRC_CYCLES_S = {"krc2": (0.012,), "krc4": (0.004, 0.012)}
"""Sample times of RSI by generation of the KRC."""

LEAST_GIVEN_PORT = 32768
"""Least port that Linux gives to sockets that ask for none, unless `ip_local_port_range` says otherwise."""


class DescriptionCheck:
    """Checks, each a generator of problems.

    Args:
        path: of the cell's file.
        cell: its description.
        placed: makes the problems.
    """

    def __init__(self, path: Path, cell: CellDescription, placed: PlacedProblems) -> None:
        self._path, self._cell, self._at = path, cell, placed.at

    def of_cell(self) -> Iterator[Problem]:
        """Problems of the cell that do not depend on its robots."""
        yield from self._ports()
        yield from self._guarded_realm()
        yield from self._open_realm()
        yield from self._timing()
        yield from self._equipment()

    def of_robot(self, name: str, robot: RobotDescription) -> Iterator[Problem]:
        """Problems of a robot's description."""
        yield from self._references(name, robot)
        yield from self._cycle(name, robot)
        yield from self._emulated_lag(name, robot)
        yield from self._krc_files(name, robot)

    def _ports(self) -> Iterator[Problem]:
        """No two listeners share a port, and no port lies in the range that the system gives to other sockets.

        RSI ports are excepted: a KRC's file names them, and KUKA's examples have 49152.
        """
        taken: dict[int, str] = {}
        of_rsi: set[FieldPath] = set()
        listeners: list[tuple[FieldPath, int]] = [
            (("hli",), Endpoint.parse(self._cell.hli).port),
            (("tcp_port",), self._cell.tcp_port),
            (("console_port",), self._cell.console_port),
        ]
        listeners += [
            (endpoint.field, Endpoint.parse(endpoint.text).port)
            for endpoint in guarded_endpoints(self._cell)
            if endpoint.text.startswith("tls/")
        ]
        for name, robot in self._cell.robots.items():
            if isinstance(robot.driver, RsiDescription):
                rsi: FieldPath = ("robots", name, "driver", "port")
                of_rsi.add(rsi)
                listeners.append((rsi, robot.driver.port))
                if robot.driver.control_port is not None:
                    listeners.append((("robots", name, "driver", "control_port"), robot.driver.control_port))
        for field, port in listeners:
            if port in taken:
                yield self._at(field, f"port {port} is that of {taken[port]} already; choose another", port)
            else:
                taken[port] = ".".join(str(part) for part in field)
                if port >= LEAST_GIVEN_PORT and field not in of_rsi:
                    told = (
                        f"Linux may give port {port} to any socket, so it may be in use at a start; "
                        f"choose one below {LEAST_GIVEN_PORT}"
                    )
                    yield self._at(field, told, port, LEAST_GIVEN_PORT - 1, severity="warning")

    def _guarded_realm(self) -> Iterator[Problem]:
        """Check that Unix permissions or TLS protect the guarded realm."""
        if (fault := guarded_fault(self._cell)) is not None:
            endpoint, told = fault
            yield self._at(endpoint.field, told, endpoint.text)

    def _open_realm(self) -> Iterator[Problem]:
        """Check that other machines can move a robot only with a token that cannot be overheard, unless permitted."""
        exposed = off_loopback(self._cell)
        if exposed is None:
            return
        if self._cell.clients_need_tokens:
            if (crosses := zenoh_in_clear(self._cell)) is not None:
                field, value = crosses
                yield self._at((field,), CROSSES_IN_CLEAR, value, severity="warning")
            return
        field, value = exposed
        if self._cell.anyone_who_connects_may_move_the_robots:
            told = "anyone who reaches this address may move the robots, reset a stop and set outputs"
            yield self._at((field,), told, value, severity="warning")
            return
        told = (
            "other machines reach this address, and would need no token to move the robots; set "
            f"`{NEEDS_TOKENS}: true` and give the HLI the tokens, listen on 127.0.0.1, or set `{ALLOWS_ANYBODY}: true`"
        )
        yield self._at((field,), told, value)

    def _timing(self) -> Iterator[Problem]:
        """Check that a healthy cycle meets every deadline of the gate."""
        least = 2 * self._cell.cycle_s
        for name in ("max_request_age_s", "gate_timeout_s", "hli_timeout_s", "krc_timeout_s"):
            value = getattr(self._cell.gate, name)
            if value < least:
                message = f"{value:g} s is less than two cycles; allow at least {least:g} s"
                yield self._at(("gate", name), message, value, least)

    def _equipment(self) -> Iterator[Problem]:
        """Bodies, robot and contact that an item of equipment names exist."""
        cell = self._cell
        for name, item in cell.equipment.items():
            named: list[tuple[FieldPath, str | None, Collection[str]]] = [
                (("bodies", index), body, cell.structure) for index, body in enumerate(item.bodies)
            ]
            named += [(("robot",), item.robot, cell.robots), (("contact",), item.contact, cell.contacts)]
            tools = [tool for robot in cell.robots.values() for tool in robot.tools]
            named.append((("tool",), item.tool, tools))
            for field, given, known in named:
                if given is not None and given not in known:
                    allowed, near = ", ".join(known) or "none", nearest_name(given, known)
                    what = {"bodies": "body of the structure"}.get(str(field[0]), str(field[0]))
                    message = f"no {what} is named '{given}'" + (f"; did you mean '{near}'?" if near else "")
                    yield self._at(("equipment", name, *field), message, given, allowed, near)

    def _references(self, name: str, robot: RobotDescription) -> Iterator[Problem]:
        """Bodies and files that a robot names exist."""
        structure = self._cell.structure
        for index, body in enumerate(robot.mounted_on):
            if body not in structure:
                allowed, near = ", ".join(structure) or "none", nearest_name(body, structure)
                message = f"no body '{body}' in the structure" + (f"; did you mean '{near}'?" if near else "")
                yield self._at(("robots", name, "mounted_on", index), message, body, allowed, near)
        if isinstance(robot.driver, RsiDescription):
            try:
                resolve_near(self._path, robot.driver.ethernet_xml)
            except FileNotFoundError as error:
                field = ("robots", name, "driver", "ethernet_xml")
                yield self._at(field, str(error), robot.driver.ethernet_xml)

    def _cycle(self, name: str, robot: RobotDescription) -> Iterator[Problem]:
        """Check that the KRC can have the cell's cycle: each of its telegrams takes one increment."""
        if not isinstance(robot.driver, RsiDescription):
            return
        cycles = KRC_CYCLES_S[robot.driver.krc]
        if not any(math.isclose(self._cell.cycle_s, cycle, abs_tol=1e-9) for cycle in cycles):
            allowed = " or ".join(f"{1000 * cycle:g} ms" for cycle in cycles)
            message = (
                f"{1000 * self._cell.cycle_s:g} ms is not the cycle of robots.{name}.driver.krc "
                f"'{robot.driver.krc}', which is {allowed}"
            )
            yield self._at(("cycle_s",), message, self._cell.cycle_s, cycles[0])

    def _emulated_lag(self, name: str, robot: RobotDescription) -> Iterator[Problem]:
        """Emulated drives are within the gate's hull of setpoints."""
        if not isinstance(robot.driver, RsiDescription):
            return
        cycle_s, presumed_s = self._cell.cycle_s, self._cell.gate.servo_lag_s
        lag_s = emulated_lag(robot.servo_lag, cycle_s).settled_s
        if lag_s > presumed_s:
            least_s = least_servo_lag_s(lag_s, cycle_s)
            message = (
                f"{presumed_s:g} s is less than the emulated drives of {name} take for {1 - REMAINDER:.0%} of a step "
                f"(robots.{name}.servo_lag: {lag_s:.3f} s); set at least {least_s:g}, or quicker drives"
            )
            yield self._at(("gate", "servo_lag_s"), message, presumed_s, least_s)

    def _krc_files(self, name: str, robot: RobotDescription) -> Iterator[Problem]:
        """Check that the KRC's files are safe and agree with the cell."""
        try:
            found = judge_krc_files(self._path, robot, self._cell.cycle_s)
        except FileNotFoundError:
            return  # reported as a reference that leads nowhere
        for finding in found:
            field = ("robots", name, "driver", *finding.field)
            yield self._at(field, str(finding), finding.value, finding.bound, severity=finding.severity)
