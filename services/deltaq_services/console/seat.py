"""The operator session of a robot: one client of this console at a time, and its handover.

The robot's driver holds the lease in that client's name. A handover is complete when the driver has answered; no
client moves the robot before that.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

from deltaq_protocol import driving
from deltaq_services.console.client import Client
from deltaq_services.console.commands import LeaseVerb
from deltaq_services.console.outputs import ToDriver

_LONGEST_NAME = 64


class _Stage(Enum):
    FREE = auto()
    TAKING = auto()
    HELD = auto()
    RELEASING = auto()


@dataclass(frozen=True)
class Handled:
    """Result of a request.

    Attributes:
        requests: for the robot's driver.
        refusal: why it was refused; empty if it was not.
        is_done: nothing is waited for.
        told: a line for the log.
    """

    requests: tuple[ToDriver, ...] = ()
    refusal: str = ""
    is_done: bool = False
    told: str = ""


class Seat:
    """The operator session of one robot.

    Args:
        robot: its name.

    Attributes:
        holder: the client that drives it, or is about to.
        wanted_by: the client that asks for it.
        text: result of the newest handover, in words.
        lease_name: name under which the lease was taken last; the HLI may report it for a moment after its release.
    """

    def __init__(self, robot: str) -> None:
        self.robot = robot
        self.holder: Client | None = None
        self.wanted_by: Client | None = None
        self.text = self.lease_name = ""
        self._next: Client | None = None
        self._stage = _Stage.FREE

    def is_held_by(self, client: Client) -> bool:
        """Whether this client may move the robot now."""
        return self.holder is client and self._stage is _Stage.HELD

    def handle(self, client: Client, action: LeaseVerb, request: Callable[[], str]) -> Handled:
        """Carry out a client's request about the lease; `request` makes the id that the driver's answer carries."""
        match action:
            case LeaseVerb.TAKE:
                return self._take(client, request)
            case LeaseVerb.TAKE_OVER:
                return self._take(client, request, by_force=True)
            case LeaseVerb.RELEASE:
                return self._released_by(client, request)
            case LeaseVerb.ASK:
                return self._asked_by(client)
            case LeaseVerb.GRANT:
                return self._granted_by(client, request)
            case LeaseVerb.REFUSE:
                return self._refused_by(client)

    def leave(self, client: Client, request: Callable[[], str]) -> tuple[ToDriver, ...]:
        """End a client's connection: its robot comes to rest and is released."""
        if self.wanted_by is client:
            self.wanted_by = None
        if self._next is client:
            self._next = None
        if self.holder is not client or self._stage is _Stage.RELEASING:
            return ()
        return self._release(request)

    def answered(
        self, request: driving.DriverRequest, answer: driving.DriverAnswer, new: Callable[[], str]
    ) -> Handled:
        """Take the driver's answer: it has taken or released the robot, or could not."""
        if isinstance(request, driving.Take) and self._stage is _Stage.TAKING:
            if answer.done and self.holder is not None:
                self._stage = _Stage.HELD
                return Handled(told=f"{self.holder.name} drives {self.robot}")
            self._stage, self.holder = _Stage.FREE, None
        elif isinstance(request, driving.Release) and self._stage is _Stage.RELEASING:
            self._stage, self.holder, successor = _Stage.FREE, None, self._next
            self._next = None
            if successor is not None:
                return self._take(successor, new)
            return Handled(told=f"{self.robot} was released")
        return Handled()

    def lost(self, why: str) -> bool:
        """Note that the driver has lost the lease; returns whether it was held."""
        was_held = self._stage is _Stage.HELD
        if was_held and self.holder is not None:
            self.text = f"{self.holder.name} has lost control: {why}"
            self._stage, self.holder = _Stage.FREE, None
        return was_held

    def driver_ended(self) -> None:
        """Note that the driver's process has ended, and the lease with it."""
        self._stage, self.holder, self._next = _Stage.FREE, None, None

    def _take(self, client: Client, request: Callable[[], str], by_force: bool = False) -> Handled:
        if self.is_held_by(client):
            return Handled(is_done=True)
        if self.holder is not None:
            return Handled(refusal=f"{self.holder.name} has {self.robot}: ask for it")
        self.holder, self._stage, self.text = client, _Stage.TAKING, ""
        if self.wanted_by is client:
            self.wanted_by = None
        self.lease_name = f"{client.name} (console)"[:_LONGEST_NAME]
        take = driving.Take(id=request(), client=self.lease_name, by_force=by_force)
        return Handled((ToDriver(self.robot, take),))

    def _released_by(self, client: Client, request: Callable[[], str]) -> Handled:
        if self.holder is not client:
            return Handled(refusal=f"{self.robot} is not yours to release")
        if self._stage is _Stage.RELEASING:
            return Handled(is_done=True)
        return Handled(self._release(request))

    def _release(self, request: Callable[[], str]) -> tuple[ToDriver, ...]:
        self._stage = _Stage.RELEASING
        rest, release = driving.GiveCommand(), driving.Release(id=request())
        return ToDriver(self.robot, rest), ToDriver(self.robot, release)

    def _asked_by(self, client: Client) -> Handled:
        if self.holder is None:
            return Handled(refusal=f"no client of this console drives {self.robot}: take it")
        if self.holder is client:
            return Handled(refusal=f"{self.robot} is yours")
        if self.wanted_by not in (None, client):
            return Handled(
                refusal=f"{self.wanted_by.name if self.wanted_by else ''} has asked for {self.robot} already"
            )
        self.wanted_by, self.text = client, ""
        return Handled(told=f"{client.name} asks {self.holder.name} for {self.robot}")

    def _granted_by(self, client: Client, request: Callable[[], str]) -> Handled:
        refusal = self._nothing_to_answer(client)
        if refusal:
            return Handled(refusal=refusal)
        self._next, self.wanted_by = self.wanted_by, None
        return Handled(self._release(request), told=f"{client.name} hands {self.robot} over")

    def _refused_by(self, client: Client) -> Handled:
        refusal = self._nothing_to_answer(client)
        if refusal:
            return Handled(refusal=refusal)
        asked, self.wanted_by = self.wanted_by, None
        self.text = f"{client.name} keeps {self.robot}"
        return Handled(
            is_done=True, told=f"{client.name} keeps {self.robot}; {asked.name if asked else ''} asked for it"
        )

    def _nothing_to_answer(self, client: Client) -> str:
        if not self.is_held_by(client):
            return f"{self.robot} is not yours to hand over"
        return "" if self.wanted_by is not None else f"no client has asked for {self.robot}"
