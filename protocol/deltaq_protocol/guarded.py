"""Messages of the guarded realm: between HLI, SIM and Robot Servers."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from deltaq_protocol.messages import (
    MOST_COUNTED_ON,
    Count,
    Joints,
    Message,
    Name,
    NearestPair,
    Phase,
    Real,
    ToolName,
    Verdict,
)
from deltaq_protocol.reasons import ReasonCode

BrakeCycles = Annotated[int, Field(ge=1, le=10_000)]


class Plan(Message):
    """The plan that a Robot Server executes: the increment `dq` that was last admitted, and the brake that follows it.

    `step` is the step that was sent last: 0 the increment itself, then the steps of the brake. At rest `dq` is
    zero. See `deltaq_protocol.brake` for the formula.
    """

    dq: Joints
    brake_cycles: BrakeCycles
    step: Count


class ServerState(Message):
    """State of one robot as its Robot Server publishes it, after it replied to the KRC.

    `process` is the instance id of the Robot Server's process: each process begins with cycle 1, and knows nothing of
    earlier holds and resets. `q_cmd` and `dq` are the setpoint just sent and its increment. `q_reset` of a held robot
    is the setpoint that the KRC has in a session that began after the hold; a reset adopts it. `sequence` is the
    admission that the robot follows in gate epoch `epoch` (0 and 0: none yet). `cell` is the identity of the cell that
    the Robot Server has read; the gate holds a robot whose server has read another cell. `lag_s` is the measured lag of
    each axis, from a setpoint's sending until all but a twentieth of a step has been measured, and null where it is not
    known; empty before it is measured. `tool` repeats that of the newest supervision, for a gate that is started again.
    All other arrays have the robot's n joints.
    """

    robot: Name
    process: Count
    cycle: Count
    ipoc: Count
    time_s: Real
    q: Joints
    q_cmd: Joints
    dq: Joints
    plan: Plan
    epoch: Count
    sequence: Count
    phase: Phase
    reason: ReasonCode | None = None
    resets: Count = 0
    q_reset: Joints | None = None
    inputs: dict[str, bool] = {}
    outputs: dict[str, bool] = {}
    counters: dict[str, Count] = {}
    cell: str = ""
    lag_s: tuple[Real | None, ...] = ()
    tool: ToolName | None = None

    @model_validator(mode="after")
    def _has_n_joints_everywhere(self) -> Self:
        n = len(self.q)
        told = (("q_cmd", self.q_cmd), ("dq", self.dq), ("plan.dq", self.plan.dq), ("q_reset", self.q_reset))
        for name, joints in told:
            if joints is not None and len(joints) != n:
                raise ValueError(f"{name} has {len(joints)} joints, q has {n}")
        return self


class Request(Message):
    """HLI to SIM, at least once a cycle and robot: the newest increment, or none as a heartbeat.

    An increment answers the state of `cycle`; `newest` is the cycle of the newest state that the HLI had when it sent
    the request, if it may differ. A heartbeat's `cycle` is that of the newest state, and its `lease_epoch` that of the
    present lease, or 0 without a lease.
    """

    robot: Name
    cycle: Count
    newest: Count | None = None
    lease_epoch: Annotated[int, Field(ge=0, lt=MOST_COUNTED_ON)]
    seq: Count = 0
    dq: Joints | None = None


class Admission(Message):
    """SIM to Robot Server: an increment and the length of the brake that follows it.

    Valid for the reply right after `cycle` only, which with a lookahead is still to come, and only if the Robot
    Server's plan is then the one that the gate assumed: it follows admission `follows_sequence`, its setpoint is
    `follows_q_cmd`, its last increment `follows_dq` and the last reset that it obeyed `follows_resets`, all compared
    exactly. So nothing behind an admission that was not taken is ever taken.
    """

    robot: Name
    epoch: Count
    sequence: Count
    cycle: Count
    follows_sequence: Count
    follows_q_cmd: Joints
    follows_dq: Joints
    follows_resets: Count = 0
    dq: Joints
    brake_cycles: BrakeCycles


class Supervision(Message):
    """SIM to Robot Server: a heartbeat, and standing orders.

    The gate makes one in each cycle. While it admits increments and its orders do not change, it sends every fourth.
    Orders are levels, not edges, so that a lost message costs a few cycles. `stop` is repeated until the state shows
    `held`. `resets` is the count of resets so far, obeyed if it is greater than the state's. A Robot Server that
    has read another `cell` holds its robot. `tool` is that which the gate counts on at the robot's tool changer: empty
    for none, null if it is not known, or if the robot has no changer.
    """

    robot: Name
    epoch: Count
    cycle: Count
    stop: ReasonCode | None = None
    resets: Count = 0
    outputs: dict[str, bool] = {}
    cell: str = ""
    tool: ToolName | None = None


class Command(Message):
    """HLI to SIM, answered by a `CommandReply`.

    Stop robots or reset one, set digital outputs, judge an increment `dq` without moving, allow a contact, or couple a
    `tool`, empty to release the present one.

    A stop is always obeyed. Any other command is taken once, in order, and only while it is fresh: by the gate of
    `epoch` only, if `id` is greater than that of every command before, and if `cycles`, the newest that the HLI had
    seen of each robot that it concerns, are no older than an increment may be.
    """

    id: Count
    kind: Literal["stop", "reset", "io", "dry_run", "contact", "tool"]
    epoch: Count = 0
    cycles: dict[Name, Count] = {}
    robot: Name | None = None
    reason: ReasonCode = ReasonCode.OPERATOR_STOP
    outputs: dict[str, bool] = {}
    dq: Joints | None = None
    contact: Name | None = None
    allowed: bool = False
    tool: ToolName = ""


class CommandReply(Message):
    """SIM to HLI: whether the command was taken, and if not, why; of a dry run the verdict.

    A stop is acted upon at once, and answered when the newest state of every robot that it concerns shows that it is
    held; a reset when the state shows that the robot is not. What no state shows is not answered.

    `epoch` and `newest_id` tell a sender that did not know them which values its next command needs.
    """

    id: Count
    accepted: bool
    code: ReasonCode | None = None
    message: str = ""
    epoch: Count | None = None
    newest_id: Count | None = None
    verdict: Verdict | None = None


class Health(Message):
    """A service's heartbeat for `deltaq up`, container health checks and `deltaq status`.

    `fingerprint` is the SIM's, a hash of the gate's code and one of its configuration, and so are the `contacts`
    that are allowed now, and the `epoch` and `newest_id` on which the next command must build. `cell` is the
    identity of the cell that the service has read.
    """

    service: Name
    healthy: bool
    detail: str = ""
    time_s: Real
    counters: dict[str, Count] = {}
    nearest: NearestPair | None = None
    fingerprint: str = ""
    contacts: tuple[Name, ...] = ()
    cell: str = ""
    epoch: Count | None = None
    newest_id: Count | None = None


class GateEntry(Message):
    """One message that the gate took, and its outputs in answer, as msgpack; published to be recorded.

    `number` counts the messages taken since the SIM began `epoch`, so that a gap shows. `topic` and the names
    in `outputs` are those of the table of topics.
    """

    epoch: Count
    number: Count
    topic: str
    payload: bytes
    outputs: tuple[tuple[str, bytes], ...] = ()


class TrackerMemory(Message):
    """Snapshot of one robot's motion in the gate: its newest state and the setpoints before it.

    `passed` says of each setpoint whether a cycle of the drives passed with it; if it is empty, one did with each.
    """

    state: ServerState | None = None
    ended_processes: tuple[Count, ...] = ()
    in_flight: tuple[Admission, ...] = ()
    missed: Count = 0
    history: tuple[Joints, ...] = ()
    passed: tuple[bool, ...] = ()


class OrdersMemory(Message):
    """Snapshot of the gate's orders to one robot."""

    standing_stop: ReasonCode | None = None
    resets: Count = 0
    outputs: dict[str, bool] = {}
    cycles_without_hli: int | None = None
    krc_silent: bool = False
    awaited_resets: tuple[Count, ...] = ()
    awaited_stops: tuple[Count, ...] = ()


class CouplingMemory(Message):
    """Snapshot of what the gate knows of the tool at a changer; see `deltaq_services.sim.gated_robot.Coupling`."""

    tool: ToolName | None = None
    wanted: ToolName | None = None
    present: tuple[Name, ...] = ()
    waited: Count = 0
    heard: bool = False


class RobotMemory(Message):
    """Snapshot of one robot in the gate: motion, orders, and the sequence of its requests.

    `decided` is the request behind the admission in flight, and `spoken_cycle` the cycle in which the HLI spoke last.
    """

    tracker: TrackerMemory
    orders: OrdersMemory
    waiting: Request | None = None
    decided: Request | None = None
    decided_cycle: int
    spoken_cycle: int = -1
    lease_epoch: Count
    seq: int
    dry_run_cycle: int = -1
    coupling: CouplingMemory | None = None


class KeptDistance(Message):
    """A violated pair of bodies, and the distance that it has to keep until its violation has ended [m]."""

    pair: tuple[str, str]
    distance_m: Real


class GateMemory(Message):
    """Snapshot of all that the gate's decisions depend on after `number` messages; a replay can restore it.

    `sequence` is that of the last admission, `command_id` the greatest of any command, `receipt` the head of the chain
    of refusals, and `fingerprint` that of the gate's code and configuration.
    """

    epoch: Count
    number: Count
    sequence: Count
    command_id: Count = 0
    receipt: str
    fingerprint: str
    contacts: tuple[Name, ...] = ()
    violations: tuple[KeptDistance, ...] = ()
    robots: dict[str, RobotMemory]
    cell: str = ""
