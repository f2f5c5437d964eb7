"""The table of reason codes: why a request was scaled, held or refused, and why a robot is held.

Verdicts, error replies, the phase of a robot, the documentation and the tests all read this table.
"""

from enum import StrEnum


class ReasonCode(StrEnum):
    """Machine-readable reasons; `EXPLANATIONS` says what each one means."""

    # limits of a request that the gate decided
    POSITION_LIMIT = "position_limit"
    VELOCITY_LIMIT = "velocity_limit"
    ACCELERATION_LIMIT = "acceleration_limit"
    CLEARANCE = "clearance"
    RETREAT = "retreat"
    SLOW_DOWN = "slow_down"
    CONTACT = "contact"
    # why a message was no valid request
    MALFORMED = "malformed"
    BAD_SHAPE = "bad_shape"
    NOT_FINITE = "not_finite"
    STALE_CYCLE = "stale_cycle"
    STALE_EPOCH = "stale_epoch"
    FUTURE_CYCLE = "future_cycle"
    LINK_TOO_SLOW = "link_too_slow"
    REPLAYED_SEQUENCE = "replayed_sequence"
    SUPERSEDED = "superseded"
    LATE = "late"
    UNKNOWN_ROBOT = "unknown_robot"
    LEASE_NOT_HELD = "lease_not_held"
    LEASE_TAKEN = "lease_taken"
    NOT_READY = "not_ready"
    STOPPED = "stopped"
    NOT_PERMITTED = "not_permitted"
    TOO_MANY = "too_many"
    PROTOCOL_VERSION = "protocol_version"
    UNREACHABLE = "unreachable"
    CELL_MISMATCH = "cell_mismatch"
    # why a robot is held
    OPERATOR_STOP = "operator_stop"
    CONTROLLER_LOST = "controller_lost"
    HLI_LOST = "hli_lost"
    GATE_LOST = "gate_lost"
    KRC_LOST = "krc_lost"
    SERVER_LOST = "server_lost"
    SERVER_ENDED = "server_ended"
    REPLY_REFUSED = "reply_refused"
    CRASH_BRAKE_LOST = "crash_brake_lost"
    TRACKING_ERROR = "tracking_error"
    RSI_MODE = "rsi_mode"
    CYCLE_MISMATCH = "cycle_mismatch"
    DRIVE_LAG = "drive_lag"
    TOOL_MISMATCH = "tool_mismatch"
    IMPOSSIBLE_STATE = "impossible_state"
    INTERNAL_ERROR = "internal_error"
    # why a reset was refused
    CAUSE_STANDS = "cause_stands"
    NOT_AT_REST = "not_at_rest"


EXPLANATIONS: dict[ReasonCode, str] = {
    ReasonCode.POSITION_LIMIT: "a joint could not be braked inside its position limit",
    ReasonCode.VELOCITY_LIMIT: "a joint would have moved faster than its velocity limit",
    ReasonCode.ACCELERATION_LIMIT: "a joint would have changed speed faster than its acceleration limit",
    ReasonCode.CLEARANCE: "two bodies could have come nearer than the stop distance",
    ReasonCode.RETREAT: "two bodies are too near already: only slow motion that does not bring them nearer is admitted",
    ReasonCode.SLOW_DOWN: "two bodies near one another would have approached too fast",
    ReasonCode.CONTACT: "while a contact is allowed, the robot moves slowly",
    ReasonCode.MALFORMED: "the message does not have the fields of its type",
    ReasonCode.BAD_SHAPE: "dq does not have one element for each joint of the robot",
    ReasonCode.NOT_FINITE: "dq has an element that is not a finite number, or is beyond what any joint can do",
    ReasonCode.STALE_CYCLE: "the message answers a cycle of the robot that is too old",
    ReasonCode.STALE_EPOCH: "the command is for a gate that has ended",
    ReasonCode.LINK_TOO_SLOW: "the increment was in transit for longer than the cell allows",
    ReasonCode.FUTURE_CYCLE: "the increment answers a cycle that has not begun",
    ReasonCode.REPLAYED_SEQUENCE: "the sequence number is not greater than the last one",
    ReasonCode.SUPERSEDED: "a newer increment of the same cycle took its place",
    ReasonCode.LATE: "the increment came too late for its cycle",
    ReasonCode.UNKNOWN_ROBOT: "the cell has no robot of that name",
    ReasonCode.LEASE_NOT_HELD: "the sender does not hold the lease of that robot",
    ReasonCode.LEASE_TAKEN: "another client holds the lease of that robot",
    ReasonCode.NOT_READY: "the robot is offline",
    ReasonCode.STOPPED: "the robot is held until a reset",
    ReasonCode.NOT_PERMITTED: "the sender is not entitled to this",
    ReasonCode.TOO_MANY: "more requests or connections came than can be served",
    ReasonCode.PROTOCOL_VERSION: "client and server speak different protocol versions",
    ReasonCode.UNREACHABLE: "a service that is needed for this did not answer",
    ReasonCode.CELL_MISMATCH: "two services have read different descriptions of the cell",
    ReasonCode.OPERATOR_STOP: "a client pressed stop",
    ReasonCode.CONTROLLER_LOST: "the controller vanished without releasing its lease",
    ReasonCode.HLI_LOST: "the High-Level Interface fell silent",
    ReasonCode.GATE_LOST: "the System Integrity Module fell silent",
    ReasonCode.KRC_LOST: "the robot controller (KRC) fell silent",
    ReasonCode.SERVER_LOST: "the Robot Server was restarted",
    ReasonCode.SERVER_ENDED: "the Robot Server was ended",
    ReasonCode.REPLY_REFUSED: "the Robot Server's last check refused a correction, which was not sent",
    ReasonCode.CRASH_BRAKE_LOST: "the crash brake's process had ended or was stopped",
    ReasonCode.TRACKING_ERROR: "the robot left its commanded path",
    ReasonCode.RSI_MODE: "the probe did not confirm that the KRC takes corrections as after RSI_ON(#ABSOLUTE)",
    ReasonCode.CYCLE_MISMATCH: "the robot's controller does not run at the cell's cycle",
    ReasonCode.DRIVE_LAG: "the drives were measured to lag more than the cell's gate.servo_lag_s",
    ReasonCode.TOOL_MISMATCH: "the tool changer's input does not confirm the tool that was requested",
    ReasonCode.IMPOSSIBLE_STATE: "a Robot Server reported a state that the gate cannot have caused",
    ReasonCode.INTERNAL_ERROR: "a service failed on a message, which it refused; its log has the traceback",
    ReasonCode.CAUSE_STANDS: "the cause of the hold persists",
    ReasonCode.NOT_AT_REST: "the robot has not come to rest yet",
}
