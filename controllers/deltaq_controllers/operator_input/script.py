"""An operator whose commands are a script: a YAML file of steps."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from deltaq_cell.problems import CellError
from deltaq_cell.yaml_tree import parse
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.interface import OperatorInput
from deltaq_protocol.driving import HAND_AXES, DrivingMode, Frame, Grip, OperatorCommand

_UNITS = {"_m_s": ("m", 1.0), "_mm_s": ("m", 1e-3), "_rad_s": ("rad", 1.0), "_deg_s": ("rad", math.pi / 180)}


ScriptMode = Literal["joint", "decoupled", "self-motion", "advisor", "coupled"]


class ScriptStep(BaseModel):
    """One step of a script: a motion and its duration."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    duration_s: FiniteFloat = Field(gt=0.0)
    """Duration; a step to an option ends earlier if the robot arrives earlier, and waits for the advisor beforehand."""
    move: dict[str, FiniteFloat] = {}
    """By axis and unit: `a1_deg_s`, `e1_m_s`, `x_m_s`, `rz_deg_s`, `left.x_mm_s`; nothing: rest."""
    mode: ScriptMode | None = None
    frame: Frame | None = None
    grip: Grip | None = None
    """Of a robot with several hands: `object` if they hold one together, `free` if they do not."""
    option: int | None = Field(default=None, ge=1)
    """Rank of the option to go to, in mode `advisor`."""
    outputs: dict[str, bool] = {}
    """Digital outputs to switch as the step begins, by name: `gripper: on`."""


class Script(OperatorInput):
    """Commands from a list of steps, one after the other on the robot's clock.

    What a step to an option comes to must not depend on how quick a computer the advisor has, so its time
    begins when the advisor has answered.

    Args:
        steps: the steps, their commands in SI units, each with its duration [s].
        arrived_at: returns the option that the robot stands at.
        awaits_advice: returns whether the advisor still looks for the option, or for a path to it.
    """

    def __init__(
        self,
        steps: Sequence[tuple[float, OperatorCommand]],
        arrived_at: Callable[[], int | None] = lambda: None,
        awaits_advice: Callable[[], bool] = lambda: False,
    ) -> None:
        self._steps = list(steps)
        self._arrived_at, self._awaits_advice = arrived_at, awaits_advice
        self._began_s: float | None = None
        self._now = 0

    @classmethod
    def load(cls, path: Path, teleoperator: Teleoperator) -> Self:
        """Read a YAML file, a list of steps, and check that the robot can do each in its mode.

        Raises:
            ControllerError: the file cannot be read, a step is not well formed, or it names something that the robot or
                the mode does not have.
        """
        mode, grip, timed = teleoperator.mode, teleoperator.grip, []
        for where, step in _read(path):
            duration_s, command = _parsed(where, step, teleoperator)
            mode, grip = command.mode or mode, command.grip or grip
            try:
                teleoperator.check(command, mode, grip)
            except ControllerError as error:
                raise ControllerError(f"{where}: {error}") from None
            timed.append((duration_s, command))
        return cls(timed, lambda: teleoperator.arrived_at, lambda: teleoperator.awaits_advice)

    def read(self, time_s: float) -> OperatorCommand | None:
        """The command of the step at this time; the first call starts the script."""
        if self._began_s is None:
            self._began_s = time_s
        while self._now < len(self._steps):
            duration_s, command = self._steps[self._now]
            if command.option is not None and self._awaits_advice():
                self._began_s = time_s
            end_s = self._began_s + duration_s
            if command.option is not None and command.option == self._arrived_at():
                end_s = time_s
            if time_s < end_s:
                return command
            self._now, self._began_s = self._now + 1, end_s
        return None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is held."""


def _read(path: Path) -> list[tuple[str, Any]]:
    """The items of a YAML list, each with its place."""
    try:
        root = parse(path.read_text(encoding="utf-8"), path.name)
    except OSError as error:
        raise ControllerError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ControllerError(f"{path.name}: is not UTF-8 text; save it as UTF-8") from None
    except CellError as error:
        raise ControllerError(str(error)) from None
    if not isinstance(root.value, list) or not root.value:
        example = "- {duration_s: 1, move: {x_m_s: 0.05}}"
        raise ControllerError(f"{path.name}: a script is a list of steps such as `{example}`")
    return [(f"{step.file}:{step.line}", step.plain()) for step in root.value]


def _parsed(where: str, step: Any, teleoperator: Teleoperator) -> tuple[float, OperatorCommand]:
    try:
        parsed = ScriptStep.model_validate(step)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"])
        given: Any = first["input"]
        what = f"{where}: {field}" if field else where
        raise ControllerError(f"{what}: {first['msg']}; got {given!r}") from None
    units = _axis_units(teleoperator)
    rates = {}
    for name, value in parsed.move.items():
        axis, rate = _rate(name, value, units, where)
        rates[axis] = rate
    return parsed.duration_s, OperatorCommand(
        rates,
        parsed.mode and DrivingMode(parsed.mode),
        parsed.frame,
        parsed.option,
        parsed.outputs,
        parsed.grip,
    )


def _axis_units(teleoperator: Teleoperator) -> dict[str, str]:
    description = teleoperator.robot.description
    units: dict[str, str] = dict(zip(description.joint_names, description.units, strict=True))
    for prefix in ("", *(f"{hand}." for hand in teleoperator.hand_names)):
        units |= {prefix + axis: "rad" if axis.startswith("r") else "m" for axis in HAND_AXES}
    return units


def _rate(name: str, value: float, units: Mapping[str, str], where: str) -> tuple[str, float]:
    """Axis and rate in SI units of a field such as `a1_deg_s`."""
    for suffix, (unit, factor) in _UNITS.items():
        axis = name.removesuffix(suffix)
        if axis != name and axis in units:
            if units[axis] != unit:
                fitting = " or ".join(
                    axis + end for end, (other, _) in _UNITS.items() if other == units[axis]
                )
                raise ControllerError(f"{where}: {name}: {axis} is in {units[axis]}; write {fitting}")
            return axis, factor * value
    raise ControllerError(
        f"{where}: {name}: not an axis with its unit; axes are {', '.join(units)}, units {', '.join(_UNITS)}"
    )


# An operator that goes to one option of the advisor, and nowhere else.


PATIENCE_S = 3.0
"""Time without progress, on the robot's clock, after which the drive ends."""


class GoToOption(OperatorInput):
    """Commands to be at an option, and is over when the robot is there.

    Args:
        teleoperator: of the robot, in mode `advisor`.
        option: its rank.

    Attributes:
        reached: whether the robot got there.
    """

    def __init__(self, teleoperator: Teleoperator, option: int) -> None:
        mode = teleoperator.mode_named(DrivingMode.ADVISOR)
        assert isinstance(mode, AdvisorMode)
        self._teleoperator, self._mode, self._option = teleoperator, mode, option
        self._got_on_s: float | None = None
        self._done = 0.0
        self.reached = False

    def read(self, time_s: float) -> OperatorCommand | None:
        """The command; None when the robot is there.

        Raises:
            ControllerError: the robot makes no progress.
        """
        self.reached = self._mode.arrived_at == self._option
        if self.reached:
            return None
        if self._got_on_s is None or self._mode.done > self._done:
            self._got_on_s, self._done = time_s, self._mode.done
        if time_s - self._got_on_s > PATIENCE_S:
            limitation = self._teleoperator.limitation
            raise ControllerError(
                f"{self._teleoperator.robot.name} makes no progress after {100 * self._done:.0f} % of the path to "
                f"option {self._option}: {limitation.text if limitation else self._mode.status}; "
                "see `deltaq status` for its phase, and advise again from where it stands"
            )
        return OperatorCommand(option=self._option)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is held."""
