"""The catalogue of faults: one row a fault, injected in virtual time, live, or into a cell that is up.

A fault of a KRC or of its wire is a request to the emulated controller's panel, in all three cases. A process that
dies or freezes does so live, too. A live wire between processes is impaired by a relay, as the wires between the
cores are in virtual time.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from deltaq_cell.models import nearest_name
from deltaq_emulator.faults import LinkFaults
from deltaq_protocol.errors import DeltaqError
from deltaq_testing.impairment.tcp import StreamFaults
from deltaq_testing.virtual_cell.parts import Link, Process


class Misbehaviour(StrEnum):
    """Misbehaviour of a controller."""

    EVERY_FOURTH = "every fourth"
    NAN_FLOOD = "nan flood"
    LEAP = "leap"


@dataclass(frozen=True)
class Kill:
    """`kill -9`."""

    process: Process


@dataclass(frozen=True)
class Freeze:
    """SIGSTOP, and SIGCONT in the end."""

    process: Process


@dataclass(frozen=True)
class Slow:
    """All messages of a process are delayed by this."""

    process: Process
    delay_s: float


@dataclass(frozen=True)
class Impair:
    """Faults of the messages on a link."""

    link: Link
    faults: LinkFaults


@dataclass(frozen=True)
class ImpairStream:
    """Faults of the bytes of the TCP connection under a link."""

    link: Link
    faults: StreamFaults


@dataclass(frozen=True)
class ReadNothing:
    """Clients ask for everything and stop reading."""


@dataclass(frozen=True)
class FillDisk:
    """The recorder's disk is full."""


@dataclass(frozen=True)
class Misbehave:
    """The controller misbehaves."""

    how: Misbehaviour


@dataclass(frozen=True)
class StepClock:
    """The monotonic clock that a process reads jumps, as forward it does when a machine stood still."""

    process: Process
    by_s: float


@dataclass(frozen=True)
class SetWallClock:
    """The time of day is set in every service, or runs too fast from now on."""

    by_s: float = 0.0
    drift_ppm: int = 0


@dataclass(frozen=True)
class BeginInThePast:
    """`kill -9`, and the process that takes its place finds the time of day set back."""

    process: Process
    by_s: float


@dataclass(frozen=True)
class AskPanel:
    """A request to the panel of the emulated controller, as JSON."""

    request: Mapping[str, Any]


class Bombard(StrEnum):
    """Foreign datagrams to the Robot Server, some in every cycle."""

    OVERSIZED = "oversized"
    """True telegrams with so much behind them that no telegram is so long."""
    PORT_ZERO = "port 0"
    """Valid telegrams from port 0, to which no answer can be sent."""


@dataclass(frozen=True)
class PressStop:
    """An operator presses stop."""


Action = (
    Kill
    | Freeze
    | Slow
    | Impair
    | ImpairStream
    | ReadNothing
    | FillDisk
    | Misbehave
    | StepClock
    | SetWallClock
    | BeginInThePast
    | AskPanel
    | Bombard
    | PressStop
)


class UnknownFaultError(DeltaqError):
    """The catalogue does not have the fault, or it cannot be injected in this way."""


CHANGE_S = 0.4
"""How long a program is stopped at least while it is changed: longer than a KRC may be silent within a session."""


@dataclass(frozen=True)
class Fault:
    """One row of the catalogue.

    Attributes:
        name: on the command line.
        what: its description.
        action: how it is injected.
        lift: a panel request that ends it, unless it ends by itself or with its process.
    """

    name: str
    what: str
    action: Action
    lift: Mapping[str, Any] | None = field(default=None)

    @property
    def changes_program(self) -> bool:
        """Whether another program is started to lift it, so that the one that runs has to be stopped before."""
        return self.lift is not None and self.lift["op"] == "restart"

    @property
    def live(self) -> bool:
        """Whether real processes can be made to suffer it."""
        match self.action:
            case Slow() | Misbehave():
                return False
            case StepClock(_, by_s):
                return by_s > 0  # a monotonic clock never goes back
        return True

    @property
    def virtual(self) -> bool:
        """Whether it can be injected in virtual time.

        There are no connections, no recorder and no time of day.
        """
        match self.action:
            case ImpairStream() | ReadNothing() | FillDisk() | SetWallClock():
                return False
            case Kill(Process.RECORDER) | Freeze(Process.RECORDER) | Impair(Link.KRC_SERVER, _):
                return False
            case StepClock(Process.SIM, _):
                return False  # the gate counts cycles and reads no clock
        return True

    @property
    def injectable(self) -> bool:
        """Whether it can be injected into a cell that is up, through the panel."""
        return isinstance(self.action, AskPanel)


_NO_MORE_FAULTS = {"op": "fault"}
_STRANGER = "127.0.0.9"
"""Another address than the emulated KRC's."""


_BETWEEN_PROCESSES = (Link.CONTROLLER_HLI, Link.HLI_SIM, Link.HLI_SERVER, Link.SIM_SERVER)


def _wire(name: str, what: str, **faults: Any) -> Fault:
    return Fault(name, what, AskPanel({"op": "fault", **faults}), _NO_MORE_FAULTS)


def _impaired(
    links: Iterable[Link],
    told: str,
    impair: Callable[[Link, Any], Action],
    kinds: Mapping[str, tuple[str, Any]],
) -> Iterator[Fault]:
    """A fault for each link and each kind of fault on it."""
    for link in links:
        for kind, (what, faults) in kinds.items():
            yield Fault(f"{link}-{kind}", f"{told.format(link)} {what}", impair(link, faults))


_SHARED = {"cut": ("carries nothing", LinkFaults(drop=1.0)), "lossy": ("loses 30 %", LinkFaults(drop=0.3))}
_MANIFOLD = {
    "duplicating": ("duplicates half", LinkFaults(duplicate=0.5)),
    "reordering": ("reorders 30 %", LinkFaults(reorder=0.3)),
}
_MESSAGES = {
    **_SHARED,
    "delayed": ("takes 30 ms, ± 20 ms", LinkFaults(delay_s=0.01, jitter_s=0.04)),
    **_MANIFOLD,
}
_STREAMS = {
    "stalled": ("stalls, and then delivers everything at once", StreamFaults(stalled=True)),
    "broken": ("is broken and refused again and again", StreamFaults(cut=True)),
}
_DATAGRAMS = {
    **_SHARED,
    "slow": ("takes 2 ms each way", LinkFaults(delay_s=0.002)),
    "late": ("takes 8 ms each way", LinkFaults(delay_s=0.008)),
    "jittery": ("takes up to 12 ms each way", LinkFaults(jitter_s=0.012)),
    **_MANIFOLD,
    "garbling": ("garbles 30 %", LinkFaults(corrupt=0.3)),
    "truncating": ("truncates 30 %", LinkFaults(truncate=0.3)),
    "misspelling": ("changes one digit in 30 %", LinkFaults(flip=0.3)),
}

CATALOGUE: tuple[Fault, ...] = (
    Fault("operator-stop", "an operator presses stop", PressStop()),
    Fault("controller-dead", "kill -9 of the controller", Kill(Process.CONTROLLER)),
    Fault("controller-frozen", "SIGSTOP of the controller", Freeze(Process.CONTROLLER)),
    Fault("controller-late", "increments come 60 ms late", Slow(Process.CONTROLLER, 0.06)),
    Fault("controller-stale", "increments come 200 ms late", Slow(Process.CONTROLLER, 0.2)),
    Fault("controller-slow", "answers every fourth state", Misbehave(Misbehaviour.EVERY_FOURTH)),
    Fault("controller-nan-flood", "20 increments of NaN a cycle", Misbehave(Misbehaviour.NAN_FLOOD)),
    Fault("controller-leap", "asks for 1 rad a cycle", Misbehave(Misbehaviour.LEAP)),
    Fault("hli-dead", "kill -9 of the HLI", Kill(Process.HLI)),
    Fault("hli-frozen", "SIGSTOP of the HLI", Freeze(Process.HLI)),
    Fault("hli-clock-forward", "the HLI's clock jumps 10 s ahead", StepClock(Process.HLI, 10.0)),
    Fault("hli-clock-back", "the HLI's clock jumps 10 s back", StepClock(Process.HLI, -10.0)),
    Fault(
        "hli-begins-in-the-past",
        "kill -9 of the HLI; the next one starts with the time of day an hour back",
        BeginInThePast(Process.HLI, -3600.0),
    ),
    Fault("sim-dead", "kill -9 of the SIM", Kill(Process.SIM)),
    Fault("sim-frozen", "SIGSTOP of the SIM", Freeze(Process.SIM)),
    Fault("sim-slow", "the SIM's answers come 18 ms late", Slow(Process.SIM, 0.018)),
    Fault("sim-clock-forward", "the SIM's clock jumps 10 s ahead", StepClock(Process.SIM, 10.0)),
    Fault("robot-server-dead", "kill -9 of the Robot Server", Kill(Process.ROBOT_SERVER)),
    Fault("robot-server-frozen", "SIGSTOP of the Robot Server", Freeze(Process.ROBOT_SERVER)),
    Fault(
        "robot-server-clock-forward",
        "the Robot Server's clock jumps 10 s ahead",
        StepClock(Process.ROBOT_SERVER, 10.0),
    ),
    Fault(
        "robot-server-clock-back",
        "the Robot Server's clock jumps 10 s back",
        StepClock(Process.ROBOT_SERVER, -10.0),
    ),
    Fault(
        "wall-clock-forward", "the time of day jumps by an hour ahead in every service", SetWallClock(3600.0)
    ),
    Fault("wall-clock-back", "the time of day jumps by an hour back in every service", SetWallClock(-3600.0)),
    Fault(
        "wall-clock-drift", "the time of day runs 5 % fast in every service", SetWallClock(drift_ppm=50_000)
    ),
    Fault("clients-not-reading", "clients over TCP and zenoh stop reading", ReadNothing()),
    Fault("recorder-dead", "kill -9 of the recorder", Kill(Process.RECORDER)),
    Fault("recorder-frozen", "SIGSTOP of the recorder", Freeze(Process.RECORDER)),
    Fault("recorder-disk-full", "the recorder's disk is full", FillDisk()),
    *_impaired(_BETWEEN_PROCESSES, "the wire {}", Impair, _MESSAGES),
    *_impaired(_BETWEEN_PROCESSES, "the connection {}", ImpairStream, _STREAMS),
    *_impaired((Link.KRC_SERVER,), "a relay on RSI's wire", Impair, _DATAGRAMS),
    _wire("krc-cut", "nothing passes between KRC and Robot Server", drop=1.0),
    _wire("krc-telegrams-lost", "30 % of the KRC's telegrams are lost", link="to_pc", drop=0.3),
    _wire("krc-replies-lost", "30 % of the replies to the KRC are lost", link="from_pc", drop=0.3),
    _wire("krc-late", "telegrams and replies take 8 ms each way", delay_s=0.008),
    _wire("krc-jitter", "telegrams and replies take up to 12 ms each way", jitter_s=0.012),
    _wire("krc-duplicating", "half of all telegrams and replies come twice", duplicate=0.5),
    _wire("krc-reordering", "30 % of all telegrams and replies are overtaken", reorder=0.3),
    _wire("krc-garbled", "30 % of the KRC's telegrams are garbled", link="to_pc", corrupt=0.3),
    _wire("krc-truncated", "30 % of the KRC's telegrams are truncated", link="to_pc", truncate=0.3),
    _wire("krc-digits", "one digit is wrong in 30 % of the KRC's telegrams", link="to_pc", flip=0.3),
    _wire("krc-replies-garbled", "30 % of the replies are garbled", link="from_pc", corrupt=0.3),
    Fault("krc-hiccup", "the KRC is silent for 8 cycles", AskPanel({"op": "fault", "freeze_cycles": 8})),
    Fault("krc-silent", "the KRC is silent for 40 cycles", AskPanel({"op": "fault", "freeze_cycles": 40})),
    Fault("krc-ipoc-back", "the IPOC jumps 24 ms back", AskPanel({"op": "fault", "ipoc_shift_ms": -24})),
    Fault("krc-ipoc-gap", "the IPOC jumps 240 ms ahead", AskPanel({"op": "fault", "ipoc_shift_ms": 240})),
    _wire(
        "krc-forged",
        "a foreign sender sends a session far ahead, with the robot 1.4° off",
        forge=[
            {"address": _STRANGER, "ipoc_shift": 60_000},
            {"address": _STRANGER, "offset_deg": 1.4},
            {"address": _STRANGER, "ipoc_shift": 60_000, "offset_deg": 1.4, "programmed_too": True},
        ],
    ),
    _wire(
        "krc-second",
        "a second KRC sends from another port, with its robot 1.4° off",
        forge=[{"ipoc_shift": 60_000, "offset_deg": 1.4, "programmed_too": True}],
    ),
    Fault("krc-oversized", "another sender sends datagrams longer than any telegram", Bombard.OVERSIZED),
    Fault("krc-port-zero", "another sender sends telegrams from port 0", Bombard.PORT_ZERO),
    Fault("krc-restarted", "the program on the KRC is started again", AskPanel({"op": "restart"})),
    Fault("krc-stopped", "stop at the KRC's pendant", AskPanel({"op": "stop"})),
    Fault("krc-drives-off", "the drives are switched off", AskPanel({"op": "drives", "on": False})),
    Fault(
        "krc-relative",
        "the program is started again with RSI_ON(#RELATIVE)",
        AskPanel({"op": "restart", "correction": "relative"}),
        {"op": "restart", "correction": "absolute"},
    ),
)
"""Every fault, from the operator's hand through the processes and wires to the robot's controller."""


_LINK, _CONTROLLERS_LINK = "link-", f"{Link.CONTROLLER_HLI}-"


def fault_named(name: str) -> Fault:
    """The row of this name; underscores may stand for hyphens, and `link` for `controller-hli`.

    Raises:
        UnknownFaultError: there is none; the message suggests the one that was probably meant.
    """
    spelled = name.replace("_", "-")
    if spelled.startswith(_LINK):
        spelled = _CONTROLLERS_LINK + spelled.removeprefix(_LINK)
    names = {row.name: row for row in CATALOGUE}
    if spelled in names:
        return names[spelled]
    meant = nearest_name(spelled, list(names))
    suggestion = f"did you mean {meant!r}? " if meant else ""
    raise UnknownFaultError(f"no fault {spelled!r}; {suggestion}`deltaq fault list` shows all")
