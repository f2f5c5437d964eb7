"""Header of every file for a KRC: what it was written from, and what nobody has tried."""

from __future__ import annotations

from deltaq_deploy.krc.plan import KrcPlan, Start

_RSI = {
    2: "RSI 2.x with Ethernet RSI XML on a KR C2",
    3: "RSI 3.x on a KR C4",
    4: "RSI 4.x and later on a KR C4 or KR C5",
}


def written_for(plan: KrcPlan) -> str:
    """The controller that the files are for."""
    return _RSI[plan.rsi]


def xml_comment(lines: list[str]) -> str:
    """The lines as a comment in XML, which has no place for two hyphens in a row."""
    return "<!-- " + "\n     ".join(lines).replace("--", "- -") + " -->\n"


def header(plan: KrcPlan, what: str) -> list[str]:
    """Lines of a comment at the head of a file; `what` names the file's purpose."""
    start = {
        Start.HOME: "RSI starts at the cell's home, to which the program moves first.",
        Start.HERE: "RSI starts where the robot stands; the software limit switches bound the motion.",
    }[plan.start]
    return [
        f"{what} for the robot {plan.robot} of the cell {plan.cell}, written by `deltaq krc files`.",
        f"For {written_for(plan)}, {plan.cycle_ms} ms. The telegrams are checked against",
        "the emulator; nothing here has been tried on a real controller of that version: read it, and start in T1.",
        start,
    ]
