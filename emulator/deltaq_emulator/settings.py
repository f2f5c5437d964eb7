"""Settings that an integrator makes at a controller: correction limits, late packets, precision, operating mode."""

from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from deltaq_cell.description import Positive
from deltaq_cell.problems import CellError
from deltaq_cell.yaml_tree import parse
from deltaq_emulator.catalogue import Code, KrcMessage
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.rsi.axes import KrcGeneration

# Number of cycles without a valid reply that a controller permits, by the rule of its generation.
#
# | rule | what counts | exceeded when |
# | --- | --- | --- |
# | `consecutive` | late cycles since the last valid reply | more than the budget |
# | `total` | late cycles since RSI_ON | more than the budget |
# | `share` | late cycles among the last 1000 telegrams | more than so many percent of 1000 |
#
# KR C4 and later permit a number of cycles (Timeout of the ETHERNET object); whether in a row or altogether is not
# known. A KR C2 permits a fraction (maxLatePackages) of a window of 1000 telegrams; those not sent yet count as
# answered.

LateRule = Literal["consecutive", "total", "share"]

FIELD_OF_VIEW = 1000
"""Telegrams among which a KR C2 counts the late ones."""


class LateBudget:
    """Counts late cycles.

    Args:
        rule: which of them count.
        cycles: permitted, where cycles are counted.
        percent: of the window permitted, where a fraction is counted.
    """

    def __init__(self, rule: LateRule, cycles: int, percent: float) -> None:
        self._rule = rule
        self._cycles = cycles
        self._percent = percent
        self.begin_session()

    def begin_session(self) -> None:
        """Count from zero."""
        self._view: deque[bool] = deque(maxlen=FIELD_OF_VIEW)
        self.counted = 0
        """Late cycles that count now."""

    def cycle(self, late: bool) -> None:
        """A cycle passed with or without a valid reply."""
        if self._rule == "consecutive" and not late:
            self.counted = 0
        if self._rule == "share":
            leaving = len(self._view) == FIELD_OF_VIEW and self._view[0]
            self._view.append(late)
            self.counted -= leaving
        self.counted += late

    @property
    def exceeded(self) -> KrcMessage | None:
        """The message if more are late than permitted."""
        if self._rule == "share":
            percent = 100.0 * self.counted / FIELD_OF_VIEW
            if percent > self._percent:
                return KrcMessage(Code.LATE_SHARE, "", percent, self._percent)
        elif self.counted > self._cycles:
            return KrcMessage(Code.LATE_PACKETS, "", self.counted, self._cycles)
        return None


SHIPPED = Path(__file__).with_name("krc_settings.yaml")
"""The emulator's default settings."""

CorrectionMode = Literal["absolute", "relative"]
"""The argument of RSI_ON."""


class SettingsError(DeltaqError):
    """Settings that cannot be read or are not allowed."""


class OperatingMode(StrEnum):
    """Operating mode of the controller; T1 and T2 are for setting up, by hand."""

    T1 = "T1"
    T2 = "T2"
    AUT = "AUT"


class KrcSettings(BaseModel):
    """Settings of an emulated controller; the defaults are the maker's, which allow hardly any motion."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    correction: CorrectionMode = "absolute"
    """RSI_ON(#ABSOLUTE): offset from where RSI started; RSI_ON(#RELATIVE): increment a cycle, so that a correction that
    stays the same is a constant velocity."""
    correction_limit_deg: Positive = 5.0
    """AXISCORR: a rotating axis is corrected by no more than this in total; the rest is clipped."""
    correction_limit_mm: Positive = 5.0
    """AXISCORREXT: the same for a linear axis."""
    monitor_limit_deg: Positive = 6.0
    """AXISCORRMON: RSI stops (KSS29000) when a rotating axis is corrected by more than this in total."""
    monitor_limit_mm: Positive = 6.0
    """The same for a linear axis."""
    late_budget: Annotated[int, Field(ge=0)] = 10
    """Timeout: cycles without a valid reply that are permitted; one more stops RSI (KSS29002)."""
    late_percent: Annotated[float, Field(ge=0, le=100)] = 10.0
    """maxLatePackages: the same for a KR C2, as a fraction of the last 1000 telegrams; the default is a stand-in."""
    late_count: LateRule | None = None
    """Which cycles count against the budget; none: as the generation does, a KR C2 the fraction, others consecutive
    ones. The maker's documents do not say whether consecutive late cycles count or all."""
    count_from: Literal["first_reply", "start"] = "first_reply"
    """Start counting against the budget when the PC has replied once, or with the first telegram as a real
    controller does. A real operator starts the program when the PC is ready; the emulator starts at once."""
    precision: Annotated[int, Field(ge=1, le=9)] = 1
    """Decimals of a DOUBLE in the controller's telegrams."""
    velocity_stop_factor: Positive = 1.1
    """Stop when an axis moves faster than its limit by this factor."""
    jump_stop_deg: Positive = 1.5
    """Stop when a setpoint of a rotating axis is further than this from where its speed would have taken it. A
    step of 1.54 degrees at standstill is known to stop a robot; the value for all axes is a stand-in."""
    jump_stop_mm: Positive = 25.0
    """The same for a linear axis; a stand-in."""
    acceleration_stop_factor: Positive = 3.0
    """Stop when the setpoint keeps accelerating above the axis's limit by this factor; a stand-in for the
    controller's model of its gears."""
    t1_speed_m_s: Positive = 0.25
    """Largest speed of the tool in T1."""
    mode: OperatingMode = OperatingMode.AUT
    """Operating mode in which it is switched on."""
    ipoc_step: Annotated[int, Field(ge=1, le=1000)] | Literal["ms"] | None = None
    """By how much the time stamp grows in a cycle: a number, or the cycle in ms; none: as the cell's
    `driver.ipoc_step` says, or else by the cycle in ms. A KR C2 with RSI 2.3 was seen to count by 1."""
    ipoc_start: Annotated[int, Field(ge=0, lt=2**32)] = 4208163634
    """Time stamp of the first telegram; a real controller's is any number."""

    @classmethod
    def load(cls, path: Path | str = SHIPPED) -> Self:
        """Read settings from a YAML file.

        Raises:
            SettingsError: if it cannot be read, or a value is not allowed.
        """
        try:
            data = parse(Path(path).read_text(encoding="utf-8"), str(path)).plain()
        except (OSError, UnicodeDecodeError, CellError) as error:
            raise SettingsError(f"{path}: cannot be read: {error}") from error
        try:
            return cls.model_validate(data or {})
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"]) or "file"
            raise SettingsError(
                f"{path}: {where}: {first['msg']}, got {first['input']!r}; allowed settings are "
                f"{', '.join(cls.model_fields)}"
            ) from error


# Differences between generations of controllers.


@dataclass(frozen=True)
class Profile:
    """One generation of controllers.

    Attributes:
        name: as in a cell's `driver.krc`; the telegram codec knows how it reports linear axes.
        cycles_s: sensor cycles it can run.
        reply_within: fraction of the cycle in which a reply has to arrive.
        ipoc_only_first: the first telegram after RSI started has nothing but its IPOC.
        late_count: which late replies count against its budget.
    """

    name: KrcGeneration
    cycles_s: tuple[float, ...]
    reply_within: float
    ipoc_only_first: bool
    late_count: LateRule


PROFILES: dict[str, Profile] = {
    "krc2": Profile("krc2", (0.012,), 10.5 / 12.0, True, "share"),
    "krc4": Profile("krc4", (0.004, 0.012), 1.0, False, "consecutive"),
}


def profile_for(krc: str, cycle_s: float) -> Profile:
    """The profile of a controller, checked for its cycle.

    Raises:
        SettingsError: if there is no such controller or it cannot run at this cycle.
    """
    if krc not in PROFILES:
        raise SettingsError(f"driver.krc is {krc!r}, allowed is {' or '.join(PROFILES)}")
    profile = PROFILES[krc]
    if not any(abs(cycle_s - allowed) < 1e-9 for allowed in profile.cycles_s):
        allowed = " or ".join(f"{cycle * 1e3:g}" for cycle in profile.cycles_s)
        raise SettingsError(
            f"cycle_s is {cycle_s:g}: a {krc} runs at {allowed} ms; change cycle_s or the robot's driver.krc"
        )
    return profile
