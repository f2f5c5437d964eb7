"""Messages of the emulated controller, as an operator would read them on the pendant."""

from dataclasses import dataclass
from enum import StrEnum


class Code(StrEnum):
    """Which message; numbers are the maker's where they are known."""

    CORRECTION_MONITOR = "KSS29000"
    LATE_PACKETS = "KSS29002"
    LATE_SHARE = "late_share"
    SOFTWARE_LIMIT = "software_limit"
    GEAR_TORQUE = "gear_torque"
    KINETIC_ENERGY = "kinetic_energy"
    T1_SPEED = "t1_speed"
    DRIVES_OFF = "drives_off"
    MODE_CHANGED = "mode_changed"
    OPERATOR_STOP = "operator_stop"
    CONFIRM_MOTION = "confirm_motion"
    MOTION_ENDED = "motion_ended"


TEXTS: dict[Code, str] = {
    Code.CORRECTION_MONITOR: "RSI: correction of {axis} is {value:.3f} {unit}, more than the monitored {bound:g}",
    Code.LATE_PACKETS: "RSI: {value:.0f} cycles without a valid reply, {bound:.0f} are permitted",
    Code.LATE_SHARE: "RSI: {value:.1f} % of the last 1000 telegrams without a valid reply, {bound:g} % are permitted",
    Code.SOFTWARE_LIMIT: "Software limit switch {axis}: {value:.3f} {unit} asked for, the limit is {bound:.3f}",
    Code.GEAR_TORQUE: "Command gear torque {axis}: {value:.2f} {unit}/s^2 asked for, {bound:.2f} is possible",
    Code.KINETIC_ENERGY: "Maximum kinetic energy exceeded {axis}: {value:.2f} {unit}/s, allowed is {bound:.2f}",
    Code.T1_SPEED: "Speed of the tool in T1: {value:.3f} m/s, allowed is {bound:g}",
    Code.DRIVES_OFF: "Drives switched off by the operator",
    Code.MODE_CHANGED: "Operating mode changed to {axis}",
    Code.OPERATOR_STOP: "Program stopped by the operator",
    Code.CONFIRM_MOTION: "Sensor corrections will move the robot: confirm",
    Code.MOTION_ENDED: "RSI_MOVECORR was ended by the signal {axis}",
}


@dataclass(frozen=True)
class KrcMessage:
    """A message with its circumstances; `axis` is e.g. `A3`, or a signal's TAG; values are in deg or mm."""

    code: Code
    axis: str = ""
    value: float = 0.0
    bound: float = 0.0
    unit: str = ""

    def __str__(self) -> str:
        text = TEXTS[self.code].format(axis=self.axis, value=self.value, bound=self.bound, unit=self.unit)
        return f"{self.code.upper()}: {text}" if self.code.startswith("KSS") else text
