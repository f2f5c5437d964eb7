"""Messages of a KRC that RSI causes: what each means, and what to do.

Numbers and wordings are the maker's where they are known; the emulator shows the same ones.
"""

from __future__ import annotations

from dataclasses import dataclass

from deltaq_emulator.catalogue import Code


@dataclass(frozen=True)
class PendantMessage:
    """A message on the pendant.

    Attributes:
        code: the emulator's name of it; None for one that it does not show.
        shown: what the pendant shows, or the part of it that is always there.
        means: why it comes.
        remedy: what to do.
    """

    code: Code | None
    shown: str
    means: str
    remedy: str


PENDANT = (
    PendantMessage(
        Code.CORRECTION_MONITOR,
        "KSS29000",
        "an axis was corrected by more than AXISCORRMON allows; without that object by more than 6 deg or 6 mm",
        "load the context that `deltaq krc files` writes: its monitors lie above its correction limits",
    ),
    PendantMessage(
        Code.LATE_PACKETS,
        "KSS29002, ETHERNET returns an error",
        "more replies were late, or missing, than Timeout permits: the PC does not listen, is too slow, or a firewall "
        "stands between",
        "start the Robot Server first; `deltaq krc sniff`, then `deltaq krc echo` and `deltaq doctor`",
    ),
    PendantMessage(
        Code.SOFTWARE_LIMIT,
        "Software limit switch",
        "a setpoint lies behind a limit of the KRC that is nearer than the cell's",
        "make the cell's limits lie inside the KRC's",
    ),
    PendantMessage(
        Code.GEAR_TORQUE,
        "Command gear torque An",
        "a setpoint jumped or accelerated more than the gear can; 1.54 deg at standstill has done it",
        "look for HOLDON 0 and relative corrections with `deltaq check`; lower max_acceleration in the cell",
    ),
    PendantMessage(
        Code.KINETIC_ENERGY,
        "Maximum kinetic energy exceeded",
        "the axes moved faster than the load allows",
        "enter tool and load at the KRC; lower max_velocity in the cell",
    ),
    PendantMessage(
        Code.T1_SPEED,
        "speed in T1",
        "the tool moved faster than T1 allows, 0.25 m/s",
        "drive slower: RSI itself limits no speed",
    ),
    PendantMessage(
        None,
        "a warning at RSI_MOVECORR (KR C2: ST_SKIPSENS) in T1",
        "sensor correction begins to move the robot",
        "make sure that the Robot Server is held, then confirm",
    ),
)


def table() -> str:
    """The messages as a table in Markdown."""
    rows = [f"| {row.shown} | {row.means} | {row.remedy} |" for row in PENDANT]
    return "\n".join(["| on the pendant | means | do |", "| --- | --- | --- |", *rows])
