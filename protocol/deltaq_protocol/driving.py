"""What an operator commands, and the lines between the console's server and the process that drives a robot.

`OperatorCommand` is the one form of a command, from any input device. The lines have one JSON object each:
requests on the driver's standard input, reports and answers on its standard output. A request with an `id` gets one
`Answer`. The end of the input is a request too: come to rest, release the robot, end.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, ClassVar, Literal

from pydantic import ConfigDict, Field, TypeAdapter

from deltaq_protocol.messages import Joints, JointValue, Message, Real

WISH_S = 0.25
"""The motion of a command ends after this time unless the next one renews it [s]."""

MOST_WAY_POINTS = 128
"""Number of configurations that describe a path."""

Coordinate = Annotated[float, Field(ge=-100.0, le=100.0, allow_inf_nan=False)]
QuaternionPart = Annotated[float, Field(ge=-2.0, le=2.0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
RequestId = Annotated[str, Field(min_length=1, max_length=64)]
CriterionName = Annotated[str, Field(min_length=1, max_length=64)]
TradeOff = tuple[CriterionName, CriterionName]


HAND_AXES = ("x", "y", "z", "rx", "ry", "rz")
"""Axes of a hand: along x, y, z [m/s] and about them [rad/s]."""


class DrivingMode(StrEnum):
    """How a robot is driven: the modes of Hooper & Noakes, Table 1, to a pose of a hand, and following with the camera.

    Keyboard, gamepad, SpaceMouse and script know the first five, `TELEOPERATION`.
    """

    JOINT = "joint"
    DECOUPLED = "decoupled"
    SELF_MOTION = "self-motion"
    ADVISOR = "advisor"
    COUPLED = "coupled"
    POSE = "pose"
    FOLLOW = "follow"


TELEOPERATION = tuple(DrivingMode)[:5]


class Frame(StrEnum):
    """The axes along which a hand moves."""

    WORLD = "world"
    TOOL = "tool"


class Grip(StrEnum):
    """Whether hands move by themselves, or hold one object together."""

    FREE = "free"
    OBJECT = "object"


@dataclass(frozen=True)
class OperatorCommand:
    """The operator's command of this cycle; an empty command is a released stick.

    Attributes:
        rates: by axis: a joint's name [rad/s or m/s], an axis of all hands (`x`, `rz`), or of one of several
            hands (`left.x`) [m/s, rad/s]. Hands that hold an object move as it does: `x` is the object's.
        mode: the mode from now on; None does not change it.
        frame: the axes from now on; None does not change them.
        option: rank of the path to follow: the advisor's option, or in mode `pose` the only one. None means
            rest, also on the path.
        outputs: digital outputs to switch now, by name; the others do not change.
        grip: whether all hands hold an object from now on; None does not change it, and so lets nothing fall.
        led: the hand that the master leads, in place of `rates`; empty for all hands or the object between them,
            None for none.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    rates: Mapping[str, JointValue] = field(default_factory=dict)
    mode: DrivingMode | None = None
    frame: Frame | None = None
    option: Annotated[int, Field(ge=1, le=99)] | None = None
    outputs: Mapping[str, bool] = field(default_factory=dict)
    grip: Grip | None = None
    led: Annotated[str, Field(max_length=64)] | None = None


StepCycles = Annotated[int, Field(ge=1, le=1000)]
MasterScale = Annotated[float, Field(ge=0.01, le=5.0, allow_inf_nan=False)]
"""Way of a hand for each metre of its master's."""


class Take(Message):
    """Take the robot's lease for a client of that name; `by_force` takes it from its holder."""

    type: Literal["take"] = "take"
    id: RequestId
    client: Annotated[str, Field(min_length=1, max_length=64)]
    by_force: bool = False


class Release(Message):
    """Bring the robot to rest and release it; answered when that is done."""

    type: Literal["release"] = "release"
    id: RequestId


class GiveCommand(Message):
    """An operator's command: its motion is good for `WISH_S`, an empty one is rest.

    In another mode or grip the robot first comes to rest in the earlier one. With an `id` it is answered, when its
    outputs are switched. `cycles` makes it a step: its motion lasts so many of the robot's cycles, not `WISH_S`.
    """

    type: Literal["command"] = "command"
    id: RequestId | None = None
    command: OperatorCommand = OperatorCommand()
    cycles: StepCycles | None = None


class ChooseMaster(Message):
    """Choose another robot of the cell as the master. Commands with `led` have its tool lead a hand; empty for none."""

    type: Literal["choose_master"] = "choose_master"
    id: RequestId
    master: Annotated[str, Field(max_length=64)] = ""
    scale: MasterScale = 1.0


class Advise(Message):
    """In mode `advisor`: look for options from where the robot rests now, or end the search and forget the choice.

    With `trade_off`, the names of two criteria, options are points of their front in place of minima of the energy.
    With `hands_may_leave` hands may leave their poses on the path to an option, and come back.
    """

    type: Literal["advise"] = "advise"
    id: RequestId
    action: Literal["ask", "cancel"]
    trade_off: TradeOff | None = None
    hands_may_leave: bool = False


class Reach(Message):
    """In mode `pose`: plan a way that brings a hand to a pose in the world; nothing moves.

    Without a `hand` it is the robot's only one. `DriverWays` has the way; the answer says why there is none.
    """

    type: Literal["reach"] = "reach"
    id: RequestId
    hand: Annotated[str, Field(max_length=64)] = ""
    position_m: tuple[Coordinate, Coordinate, Coordinate]
    quaternion_wxyz: tuple[QuaternionPart, QuaternionPart, QuaternionPart, QuaternionPart]


class ReachJoints(Message):
    """In mode `pose`: plan the path to a configuration, (n,) [rad or m], as `Reach` does to a pose."""

    type: Literal["reach_joints"] = "reach_joints"
    id: RequestId
    q: Joints


class DoRoutine(Message):
    """Run a routine from its step `first` (from 0) on, or plan it; or pause the one that runs, go on, or give it up.

    `DriverWays` has what was planned, and nothing moves.
    Without `equipment` it is one that needs none. What else the robot is told to do waits until the routine has ended.
    """

    type: Literal["routine"] = "routine"
    id: RequestId
    action: Literal["plan", "run", "pause", "go_on", "abort"]
    routine: Annotated[str, Field(max_length=64, pattern=r"^[A-Za-z0-9_-]*$")] = ""
    equipment: Annotated[str, Field(max_length=64)] = ""
    first: Annotated[int, Field(ge=0, le=1000)] = 0


DriverRequest = Take | Release | GiveCommand | ChooseMaster | Advise | Reach | ReachJoints | DoRoutine
REQUESTS: TypeAdapter[DriverRequest] = TypeAdapter(Annotated[DriverRequest, Field(discriminator="type")])


class DriverAnswer(Message):
    """The outcome of the request `id`; if it was not done, `text` says why."""

    type: Literal["answer"] = "answer"
    id: str
    done: bool
    text: str = ""


class DriverStage(StrEnum):
    """How far the driver is."""

    STARTING = "starting"
    FREE = "free"
    LEASED = "leased"


class Search(Message):
    """Progress of the search for paths, and of the robot on one of them.

    `done` is the fraction of the step `doing` that is done. `way` is the rank of the way that was begun, `driven` the
    fraction of its duration that has been driven; `arrived` says that the robot stands at its end. `trade_off`
    names the two criteria whose Pareto front the options form; None: the options are minima of the energy.
    `hands_may_leave` says that hands may leave their place on the way to an option, and come back.
    """

    doing: str = ""
    done: Fraction = 0.0
    is_busy: bool = False
    trials: int = 0
    way: int | None = None
    driven: Fraction = 0.0
    arrived: bool = False
    trade_off: TradeOff | None = None
    hands_may_leave: bool = False


class HandsOff(Message):
    """By how much hands that hold an object are off from how they took it, to one another, as measured."""

    distance_m: Real
    angle_rad: Real


class RoutineProgress(Message):
    """The routine that runs, or that ran last: the present `step` of `steps`, from 0, and the share of it that is done.

    `end` says how the run ended, empty while it lasts, and `why` the reason; it can be taken up at `step` unless that
    is the last.
    """

    routine: str
    equipment: str = ""
    step: int = 0
    steps: int = 0
    text: str = ""
    done: Fraction = 0.0
    paused: bool = False
    end: str = ""
    why: str = ""


class DriverReport(Message):
    """The driver's status, sent some times a second while it changes.

    `limit` names in words what limits the operator now, `doing` what the mode does. `goes_through` is the executed
    fraction of the command, in tenths; 1 if nothing limits it. `search` is present in modes that offer paths. `grip`
    is the chosen grip; `hands_off` is present once an object is held. `master` names the robot that leads an end
    effector, with its displacement times `master_scale`; empty if none was chosen. `routines` are the routines that
    there are, by kind of equipment; those that need none are under an empty name.
    """

    type: Literal["report"] = "report"
    stage: DriverStage
    mode: DrivingMode
    frame: Frame = Frame.WORLD
    grip: Grip = Grip.FREE
    hands_off: HandsOff | None = None
    master: str = ""
    master_scale: Real = 1.0
    limit: str = ""
    goes_through: Fraction = 1.0
    doing: str = ""
    distance_m: Real | None = None
    search: Search | None = None
    routines: dict[str, tuple[str, ...]] = {}
    routine: RoutineProgress | None = None


class NearPair(Message):
    """Two bodies that are near, and their distance [m]."""

    distance_m: Real
    pair: tuple[str, str]


class Way(Message):
    """One offered path: an option of the advisor, or the path to a pose.

    `rank` is the number by which it is chosen, and `q` the configuration at its end, (n,) [rad or m]. `points` are
    configurations along the path from its start; if no path is known it is empty, and `why_not` says why. The advisor
    ranks by `energy`; `energy_here` is the energy of the present configuration, and `costs` are the costs by
    criterion, from 0 (good) to 1 (bad). `near` has the nearest bodies of each kind, `self`, `environment` and
    `robots`, without pairs whose distance the hands' poses determine. `hands_leave`: the end effectors leave their
    poses along the path and return to them. `clearance_m` is the distance of `pair`, the nearest bodies: at the end
    of an option, or the least along a path to a pose. `clear` is the fraction of the path that keeps all distances
    and limits in a simulation with the other robots at rest; `text` says this in words. `first` is the first
    increment of the path, for the gate's dry run.
    """

    rank: Annotated[int, Field(ge=1, le=99)]
    q: Joints
    points: Annotated[tuple[Joints, ...], Field(max_length=MOST_WAY_POINTS)] = ()
    why_not: str = ""
    energy: Real | None = None
    energy_here: Real | None = None
    costs: dict[str, Real] = {}
    near: dict[str, NearPair] = {}
    hands_leave: bool = False
    clearance_m: Real | None = None
    pair: tuple[str, str] | None = None
    nearest_limit: str = ""
    limit_share: Real | None = None
    clear: Fraction = 1.0
    text: str = ""
    first: Annotated[tuple[JointValue, ...], Field(max_length=32)] = ()


class DriverWays(Message):
    """All paths offered now, sent when they change; none after a change of mode.

    With `routine` and `equipment` it is the whole path of a routine that was planned.
    """

    type: Literal["ways"] = "ways"
    mode: DrivingMode
    ways: tuple[Way, ...] = ()
    routine: str = ""
    equipment: str = ""


DriverMessage = DriverAnswer | DriverReport | DriverWays
SAID: TypeAdapter[DriverMessage] = TypeAdapter(Annotated[DriverMessage, Field(discriminator="type")])
