"""What operators ask of robots, what their drivers answer, and who is told."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from deltaq_protocol import driving
from deltaq_services.console.client import Client
from deltaq_services.console.commands import (
    DryRun,
    Jog,
    LeaseCommand,
    LeaseVerb,
    Reset,
    RobotCommand,
    ViewCommand,
)
from deltaq_services.console.messages import AckOutcome, WaysView
from deltaq_services.console.outputs import (
    AskHli,
    ConsoleOutput,
    PendingRequests,
    ToClient,
    ToDriver,
    acknowledged,
)
from deltaq_services.console.robot_side import RobotSide
from deltaq_services.console.seat import Handled
from deltaq_services.console.status_board import EventLog

_WAITED_FOR = (LeaseVerb.TAKE, LeaseVerb.TAKE_OVER, LeaseVerb.RELEASE)


class DriverDesk:
    """Commands to robots, and the lines of their drivers.

    Args:
        robots: each robot's side.
        clients: connected browsers, by the number of the connection.
        pending: answers that are awaited from the HLI and from drivers.
        log: of events.
        counters: of what was refused.
    """

    def __init__(
        self,
        robots: Mapping[str, RobotSide],
        clients: Mapping[int, Client],
        pending: PendingRequests,
        log: EventLog,
        counters: Counter[str],
    ) -> None:
        self._robots, self._clients, self._pending, self._log = robots, clients, pending, log
        self._counters = counters

    def leave(self, client: Client) -> list[ConsoleOutput]:
        """A client commands no more: robots that it drives come to rest and are released."""
        outputs: list[ConsoleOutput] = []
        for side in self._robots.values():
            outputs += self._pending.send(side.seat.leave(client, self._pending.new_id), None, "")
        return outputs

    def rest(self, client: Client) -> list[ConsoleOutput]:
        """A client's page is gone, maybe for a moment: what it drives rests; what moves by itself is released."""
        outputs: list[ConsoleOutput] = []
        for side in self._robots.values():
            if side.seat.holder is not client:
                continue
            if side.report is not None and side.report.mode is driving.DrivingMode.FOLLOW:
                outputs += self._pending.send(side.seat.leave(client, self._pending.new_id), None, "")
            else:
                outputs.append(ToDriver(side.name, driving.GiveCommand()))
        return outputs

    def said(self, robot: str, said: driving.DriverMessage, now_s: float) -> list[ConsoleOutput]:
        """A line of a robot's driver."""
        side = self._robots[robot]
        if isinstance(said, driving.DriverWays):
            side.ways = WaysView(robot=robot, mode=said.mode, ways=said.ways)
            return [ToClient(number, side.ways) for number in self._clients]
        if isinstance(said, driving.DriverReport):
            side.report = said
            if said.stage is driving.DriverStage.FREE and side.seat.lost(said.doing):
                self._log.add(now_s, "lease", f"the lease was lost: {said.doing}", robot)
            return []
        client, command, asked = self._pending.answered(said.id)
        outputs: list[ConsoleOutput] = []
        if isinstance(asked, ToDriver):
            self._counters["refused_by_driver"] += not said.done
            handled = side.seat.answered(asked.request, said, self._pending.new_id)
            self._tell(handled, robot, now_s)
            outputs += self._pending.send(handled.requests, None, "")
        if client is not None and client.number in self._clients:
            outcome = AckOutcome.DONE if said.done else AckOutcome.REFUSED
            outputs.append(acknowledged(client, command, outcome, said.text))
        return outputs

    def ended(self, robot: str, text: str, now_s: float) -> list[ConsoleOutput]:
        """A robot's driver is gone: its open requests were not carried out."""
        side = self._robots[robot]
        side.seat.driver_ended()
        side.report = None
        side.ways = None
        self._log.add(now_s, "lease", f"the driver has ended: {text}", robot)
        return [
            acknowledged(client, command, AckOutcome.REFUSED, f"the driver has ended: {text}")
            for client, command, _ in self._pending.given_up(robot)
            if client is not None and client.number in self._clients
        ]

    def obey(self, client: Client, command: RobotCommand, now_s: float) -> list[ConsoleOutput]:
        """Carry out what an operator asks of a robot, or raise `ValueError` with the reason why not."""
        side = self._robots.get(command.robot)
        if side is None:
            raise ValueError(
                f"robot: the cell has no robot {command.robot!r}; it has {', '.join(self._robots)}"
            )
        if isinstance(command, Reset):
            return self._pending.ask(client, command.id, AskHli(self._pending.new_id(), "reset", side.name))
        if isinstance(command, DryRun):
            dq = side.checked(command)
            return self._pending.ask(
                client, command.id, AskHli(self._pending.new_id(), "dry_run", side.name, dq)
            )
        if isinstance(command, LeaseCommand):
            return self._lease(client, command, side, now_s)
        if isinstance(command, ViewCommand):  # for whoever follows with the robot, here or elsewhere
            asked = AskHli(self._pending.new_id(), "view", side.name, view=side.view_of(command))
            return self._pending.ask(client, command.id, asked)
        if not side.seat.is_held_by(client):
            holder = side.seat.holder
            raise ValueError(
                f"robot: {side.name} is not yours to move: "
                + ("take it" if holder is None else f"{holder.name} has it")
            )
        if isinstance(command, Jog):
            wish = side.wish_of(command)
            cannot = side.cannot_move(now_s)
            if cannot:
                raise ValueError(cannot)
            return [ToDriver(side.name, wish), acknowledged(client, command.id, AckOutcome.DONE, "")]
        request = side.request_of(command, self._pending.new_id())
        sent = self._pending.send([ToDriver(side.name, request)], client, command.id)
        return [*sent, acknowledged(client, command.id, AckOutcome.ASKED, "asked")]

    def _lease(
        self, client: Client, command: LeaseCommand, side: RobotSide, now_s: float
    ) -> list[ConsoleOutput]:
        handled = side.seat.handle(client, command.action, self._pending.new_id)
        if handled.refusal:
            raise ValueError(f"action: {handled.refusal}")
        self._tell(handled, side.name, now_s)
        if command.action is LeaseVerb.TAKE_OVER and not handled.is_done:
            from_whom = side.outside_holder or "nobody"
            self._log.add(now_s, "lease", f"{client.name} takes {side.name} from {from_whom}", side.name)
        # who grants a robot is not told when it was taken by another
        waits = client if command.action in _WAITED_FOR else None
        outcome = AckOutcome.ASKED if waits is not None and not handled.is_done else AckOutcome.DONE
        sent = self._pending.send(handled.requests, waits, command.id)
        return [*sent, acknowledged(client, command.id, outcome, "")]

    def _tell(self, handled: Handled, robot: str, now_s: float) -> None:
        if handled.told:
            self._log.add(now_s, "lease", handled.told, robot)
