"""Differences between generations of controllers."""

from __future__ import annotations

from dataclasses import dataclass

from deltaq_emulator.late_budget import LateRule
from deltaq_emulator.settings import SettingsError
from deltaq_protocol.rsi.axes import KrcGeneration


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
    """The profile of a controller that is to run at this cycle.

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
