"""The console's decisions: rights of clients, requests to drivers and to the HLI, messages to browsers.

No clock, no socket. The caller passes times: `now_s` of one clock, which frames show as the server's.
"""

import itertools
from collections import Counter
from collections.abc import Mapping

from deltaq_cell.description import CellDescription
from deltaq_protocol import driving
from deltaq_protocol.messages import Verdict
from deltaq_services.console.client import Client, ClockOffset
from deltaq_services.console.commands import (
    EXPIRY_S,
    AnyCommand,
    DryRun,
    InvalidCommandError,
    Jog,
    LeaseCommand,
    LeaseVerb,
    Ping,
    Record,
    ReplayShown,
    Reset,
    RobotCommand,
    Stop,
    ViewCommand,
    command_of,
)
from deltaq_services.console.messages import Ack, AckOutcome, ConsoleHello, Pong, WaysView, bound_of
from deltaq_services.console.outputs import (
    AskHli,
    ConsoleOutput,
    PendingRequests,
    ToClient,
    ToDriver,
    acknowledged,
)
from deltaq_services.console.picture import Picture
from deltaq_services.console.robot_side import RobotSide
from deltaq_services.console.seat import Handled
from deltaq_services.console.status_board import EventLog, RecordingDesk, StatusBoard, StopProgress

_WAITED_FOR = (LeaseVerb.TAKE, LeaseVerb.TAKE_OVER, LeaseVerb.RELEASE)
MOST_CLIENTS = 32
AWAY_S = 5.0
"""A page that is reloaded within this time keeps its name and its robots, which rest until then."""


class ConsoleCore:
    """The console of one cell.

    Args:
        cell: its description.
        bodies: names of its bodies, as the scene lists them.
        token_needed: whether a client without the token is an observer.
        has_recordings: whether it was given a folder for recordings.
        process: distinguishes this console process from earlier ones.
        name: of the cell or its file, as commands take it.

    Attributes:
        clients: connected browsers, by the number of the connection.
        counters: of what browsers sent.
        robots: each robot's side.
        picture: the camera views of the cell.
        stop: the progress of the newest stop.
        board: the status that browsers get when it changes.
        desk: the recording that is being written.
    """

    def __init__(
        self,
        cell: CellDescription,
        bodies: tuple[str, ...],
        token_needed: bool,
        has_recordings: bool = False,
        process: str = "",
        name: str = "",
    ) -> None:
        self._process = process
        self.clients: dict[int, Client] = {}
        self.counters: Counter[str] = Counter()
        self.stop = StopProgress()
        places = {name: place for place, name in enumerate(bodies)}
        self.robots = {
            name: RobotSide(
                name, robot, cell.cycle_s, places, tuple(each for each in cell.robots if each != name)
            )
            for name, robot in cell.robots.items()
        }
        self._log = EventLog()
        self.picture = Picture(cell, bodies, self.robots, self._log)
        self.desk = RecordingDesk(cell.cell, has_recordings)
        self.board = StatusBoard(self.robots, self.desk, self._log, name or cell.cell)
        self._away: dict[str, tuple[float, Client]] = {}
        self._token_needed = token_needed
        self._numbers = itertools.count(1)
        self._pending = PendingRequests()

    def connect(
        self, name: str, is_operator: bool, now_s: float, address: str = "", session: str = "", page: str = ""
    ) -> tuple[Client | None, list[ConsoleOutput]]:
        """Connect a browser; returns its client, or none if there are too many."""
        again = next((one for one in self.clients.values() if session and one.session == session), None)
        if again is not None and page and again.page == page:
            # the page has given up its connection, and the end of that connection was not seen yet
            self._away[session] = (now_s, self.clients.pop(again.number))
            self.board.forget(again)
        if len(self.clients) >= MOST_CLIENTS:
            self.counters["clients_refused"] += 1
            return None, []
        _, client = self._away.pop(session, (0.0, None))
        left: list[ConsoleOutput] = []
        if client is not None and (client.given_name, client.is_operator) != (name, is_operator):
            left, client = self._left(client, now_s), None  # it has come back as another
        if client is None:
            in_use = any(each.session == session for each in self.clients.values())
            client = Client(next(self._numbers), self._free_name(name, is_operator), is_operator)
            client.session, client.given_name = "" if in_use else session, name
            self.counters["clients"] += 1
            self._log.add(now_s, "client", f"{client.name} has connected")
        client.address, client.page, client.clocks, number = address, page, ClockOffset(), client.number
        self.clients[number] = client
        hello = ConsoleHello(
            console=self._process,
            client=client.name,
            operator=is_operator,
            token_needed=self._token_needed,
        )
        ways = (side.ways for side in self.robots.values() if side.ways is not None)
        return client, [*left, *(ToClient(number, message) for message in (hello, *self._log.kept, *ways))]

    def disconnect(self, client: Client, now_s: float) -> list[ConsoleOutput]:
        """Disconnect a browser: its robots come to rest, and are released unless it reconnects in time."""
        del self.clients[client.number]
        self.board.forget(client)
        if client.session and not client.shows_replay:
            self._away[client.session] = (now_s + AWAY_S, client)
            return self._rest(client)
        return self._left(client, now_s)

    def _left(self, client: Client, now_s: float) -> list[ConsoleOutput]:
        self._log.add(now_s, "client", f"{client.name} has disconnected")
        return self._leave(client)

    def _free_name(self, name: str, is_operator: bool) -> str:
        """The name that a browser gave itself, with a number if another has it."""
        away = (client for _, client in self._away.values())
        taken = {client.name for client in (*self.clients.values(), *away)}
        if name and name not in taken:
            return name
        kind = name or ("operator" if is_operator else "observer")
        numbered = (f"{kind} {number}" for number in itertools.count(2 if name else 1))
        return next(each for each in numbered if each not in taken)

    def take(self, client: Client, message: str | bytes, now_s: float) -> list[ConsoleOutput]:
        """Take a message of a browser; every message is answered, also an invalid one."""
        self.counters["messages"] += 1
        allowed = client.rate.take(now_s)
        try:
            command = command_of(message)
        except InvalidCommandError as error:
            self.counters["malformed"] += 1
            return [acknowledged(client, error.id, AckOutcome.REFUSED, str(error))] if allowed else []
        if isinstance(command, Stop):
            return self._stop(client, command, now_s)
        if not allowed:
            self.counters["too_many"] += 1
            text = f"messages: more in a second than are allowed; bound {client.rate.most_s:g}"
            return [acknowledged(client, command.id, AckOutcome.REFUSED, text)]
        late_s = client.clocks.hear(command.sent_ms / 1000.0, now_s)
        if isinstance(command, Ping):
            pong = Pong(id=command.id, sent_ms=command.sent_ms, server_ms=1000.0 * now_s)
            return [ToClient(client.number, pong)]
        if late_s > EXPIRY_S[command.type]:
            self.counters["expired"] += 1
            text = f"your browser was {late_s:.2f} s late; bound {EXPIRY_S[command.type]:g} s: press again"
            return [acknowledged(client, command.id, AckOutcome.EXPIRED, text)]
        try:
            return self._obey(client, command, now_s)
        except ValueError as error:
            self.counters["refused"] += 1
            return [acknowledged(client, command.id, AckOutcome.REFUSED, str(error))]

    def answered(
        self, request: str, done: bool, text: str, now_s: float, verdict: Verdict | None = None
    ) -> list[ConsoleOutput]:
        """Take the HLI's answer to a request, or the reason why there is none."""
        client, command, asked = self._pending.answered(request)
        assert isinstance(asked, AskHli)
        if asked.kind == "stop":
            if done:
                self.stop.latched()
            self._log.add(
                now_s, "stop", "every robot is held" if done else f"the stop is not confirmed: {text}"
            )
        if asked.kind == "reset" and client is not None:
            did = "has reset it" if done else f"could not reset it: {text}"
            self._log.add(now_s, "phase", f"{client.name} {did}", asked.robot)
        outcome = AckOutcome.DONE if done else AckOutcome.REFUSED
        if client is None or client.number not in self.clients:
            return []
        ack = Ack(id=command, outcome=outcome, text=text)
        if verdict is not None:
            bound = bound_of(verdict, self.robots[asked.robot].units)
            text = "" if bound is None else bound.text
            told = {"text": text, "verdict": verdict.outcome, "scale": verdict.scale, "pair": verdict.pair}
            ack = ack.model_copy(update=told)
        return [ToClient(client.number, ack)]

    def driver_said(self, robot: str, said: driving.DriverMessage, now_s: float) -> list[ConsoleOutput]:
        """A line of a robot's driver."""
        side = self.robots[robot]
        if isinstance(said, driving.DriverWays):
            view = WaysView(robot=robot, **dict(said))
            side.ways = side.ways if said.routine else view
            return [ToClient(number, view) for number in self.clients]
        if isinstance(said, driving.DriverReport):
            side.report = said
            if said.stage is driving.DriverStage.FREE and side.seat.lost(said.doing):
                self._log.add(now_s, "lease", f"the lease was lost: {said.doing}", robot)
            return []
        client, command, asked = self._pending.answered(said.id)
        outputs: list[ConsoleOutput] = []
        if isinstance(asked, ToDriver):
            self.counters["refused_by_driver"] += not said.done
            handled = side.seat.answered(asked.request, said, self._pending.new_id)
            self._tell(handled, robot, now_s)
            outputs += self._pending.send(handled.requests, None, "")
        if client is not None and client.number in self.clients:
            outcome = AckOutcome.DONE if said.done else AckOutcome.REFUSED
            outputs.append(acknowledged(client, command, outcome, said.text))
        return outputs

    def driver_ended(self, robot: str, text: str, now_s: float) -> list[ConsoleOutput]:
        """Note that a robot's driver has ended, and refuse its open requests."""
        side = self.robots[robot]
        side.seat.driver_ended()
        side.report = None
        side.ways = None
        self._log.add(now_s, "lease", f"the driver has ended: {text}", robot)
        return [
            acknowledged(client, command, AckOutcome.REFUSED, f"the driver has ended: {text}")
            for client, command, _ in self._pending.given_up(robot)
            if client is not None and client.number in self.clients
        ]

    def unconfirmed(self, why: str, now_s: float) -> None:
        """Report that the stop was not confirmed in time; the console keeps asking."""
        self._log.add(now_s, "stop", f"the stop is not confirmed: {why} Use the emergency stop.")

    def recorder_ended(self, why: str, now_s: float) -> None:
        """Note that the recorder has ended; `why` is empty if it was asked to."""
        self._log.add(now_s, "recording", self.desk.ended(why))

    def signals(self, robot: str, outputs: Mapping[str, bool], inputs: Mapping[str, bool]) -> None:
        """A robot's digital outputs and inputs."""
        self.robots[robot].outputs |= outputs
        self.robots[robot].inputs |= inputs

    def tick(self, now_s: float) -> list[ConsoleOutput]:
        """The messages that browsers must get now, in addition to frames."""
        self.stop.see({name: side.motion(now_s) for name, side in self.robots.items()})
        gone = [session for session, (until_s, _) in self._away.items() if now_s >= until_s]
        outputs: list[ConsoleOutput] = []
        for session in gone:
            _, client = self._away.pop(session)
            outputs += self._left(client, now_s)
        return [*outputs, *self.board.tell(self.clients.values(), self.stop, now_s)]

    def health(self) -> dict[str, object]:
        """The console's report on itself."""
        browsers = f"browsers: {len(self.clients)}"
        return {
            "healthy": self.board.hli,
            "detail": browsers if self.board.hli else f"{browsers}; {self.board.text}",
            "counters": dict(self.counters),
        }

    def _stop(self, client: Client, command: Stop, now_s: float) -> list[ConsoleOutput]:
        self.counters["stops"] += 1
        self.stop.ask(client.name)
        self._log.add(now_s, "stop", f"{client.name} pressed STOP")
        # robots that this console drives come to rest even if the HLI cannot be reached
        rest = [
            ToDriver(side.name, driving.GiveCommand())
            for side in self.robots.values()
            if side.seat.holder is not None
        ]
        return [*self._pending.ask(client, command.id, AskHli("stop")), *rest]

    def _obey(self, client: Client, command: AnyCommand, now_s: float) -> list[ConsoleOutput]:
        """Carry a command out, or raise `ValueError` with the reason why not."""
        assert not isinstance(command, Ping | Stop)  # served before
        if isinstance(command, ReplayShown):
            return [
                *self._replay(client, command.shown),
                acknowledged(client, command.id, AckOutcome.DONE, ""),
            ]
        if client.shows_replay:
            raise ValueError("a recording is shown in this browser: close it to command the cell")
        if not client.is_operator:
            raise ValueError(
                "an observer may only watch and press STOP; open the page with the console's token to do more"
            )
        if isinstance(command, Record):
            to_recorder = self.desk.handle(command, now_s)
            begins = f"{client.name} records {to_recorder.file}"
            self._log.add(
                now_s, "recording", begins if to_recorder.file else f"{client.name} ends the recording"
            )
            return [to_recorder, acknowledged(client, command.id, AckOutcome.DONE, "")]
        return self._command(client, command, now_s)

    def _replay(self, client: Client, shown: bool) -> list[ConsoleOutput]:
        """A browser begins or ends showing a recording: the robots that it drives rest and are released."""
        client.shows_replay = shown
        return self._leave(client) if shown else []

    def _leave(self, client: Client) -> list[ConsoleOutput]:
        """A client commands no more: robots that it drives come to rest and are released."""
        outputs: list[ConsoleOutput] = []
        for side in self.robots.values():
            outputs += self._pending.send(side.seat.leave(client, self._pending.new_id), None, "")
        return outputs

    def _rest(self, client: Client) -> list[ConsoleOutput]:
        """A client's page is gone, maybe for a moment: its robots rest; robots in automatic modes are released."""
        outputs: list[ConsoleOutput] = []
        for side in self.robots.values():
            if side.seat.holder is not client:
                continue
            if side.report is not None and side.report.mode is driving.DrivingMode.FOLLOW:
                outputs += self._pending.send(side.seat.leave(client, self._pending.new_id), None, "")
            else:
                outputs.append(ToDriver(side.name, driving.GiveCommand()))
        return outputs

    def _command(self, client: Client, command: RobotCommand, now_s: float) -> list[ConsoleOutput]:
        """Carry out an operator's command to a robot, or raise `ValueError` with the reason why not."""
        side = self.robots.get(command.robot)
        if side is None:
            raise ValueError(
                f"robot: the cell has no robot {command.robot!r}; it has {', '.join(self.robots)}"
            )
        if isinstance(command, Reset):
            return self._pending.ask(client, command.id, AskHli("reset", side.name))
        if isinstance(command, DryRun):
            return self._pending.ask(client, command.id, AskHli("dry_run", side.name, side.checked(command)))
        if isinstance(command, LeaseCommand):
            return self._lease(client, command, side, now_s)
        if isinstance(command, ViewCommand):  # for the robot's camera follower, here or elsewhere
            asked = AskHli("view", side.name, view=side.view_of(command))
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
        # a client that grants a robot gets no message when another client has taken it
        waits = client if command.action in _WAITED_FOR else None
        outcome = AckOutcome.ASKED if waits is not None and not handled.is_done else AckOutcome.DONE
        sent = self._pending.send(handled.requests, waits, command.id)
        return [*sent, acknowledged(client, command.id, outcome, "")]

    def _tell(self, handled: Handled, robot: str, now_s: float) -> None:
        if handled.told:
            self._log.add(now_s, "lease", handled.told, robot)
