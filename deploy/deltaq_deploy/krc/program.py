"""The KRL program that starts RSI and ends it.

KR C4: after the calls of RSI 3 and later as published programs have them. KR C2: after a program that has run on one
(ST_ETHERNET, ST_AXISCORR, ST_NEWLINK, ST_SETPARAM, ST_ON, ST_SKIPSENS, ST_OFF); ST_BREAKMOVE is known from one
description alone.
"""

from __future__ import annotations

from collections.abc import Iterable

from deltaq_deploy.krc.header import header
from deltaq_deploy.krc.plan import TIMEOUT_CYCLES, Correction, KrcPlan, Start, written

_OPTION = {4: "#IPO_FAST", 12: "#IPO"}

_INI = """\
;FOLD INI
  ;FOLD BASISTECH INI
    GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
    INTERRUPT ON 3
    BAS (#INITMOV,0 )
  ;ENDFOLD (BASISTECH INI)
;ENDFOLD (INI)
"""


def program(plan: KrcPlan) -> str:
    """The text of the `.src`."""
    body = _of_krc2(plan) if plan.krc == "krc2" else _of_krc4(plan)
    comment = "\n".join(f"; {line}" for line in header(plan, "Starts RSI"))
    return f"&ACCESS RVP\n&REL 1\nDEF {plan.program}( )\n{comment}\n\n{body}\nEND\n"


def _to_start(plan: KrcPlan) -> str:
    move = "; a first motion, so that the program knows where the robot is\nPTP $AXIS_ACT\n"
    if plan.start is Start.HERE:
        return move
    places = ", ".join(f"{one.axis} {written(one.home)}" for one in plan.corrections)
    kind = "E6AXIS" if plan.external else "AXIS"
    return (
        f"{move}; the cell's home: corrections, and their limits, count from here\nPTP {{{kind}: {places}}}\n"
    )


def _of_krc4(plan: KrcPlan) -> str:
    # RSI 4 and later take the name without its suffix
    context = f"{plan.program}.rsi" if plan.rsi == 3 else plan.program
    return f"""\
DECL INT ret, context

{_INI}
{_to_start(plan)}
{_checked("ret", f'RSI_CREATE("{context}", context, TRUE)', "RSIOK", "the context")}
; Counting of late replies begins at once: start the Robot Server now, then go on.
HALT

{_checked("ret", f"RSI_ON(#ABSOLUTE, {_OPTION[plan.cycle_ms]})", "RSIOK", "corrections from the start pose")}
; Moves by corrections until the signal Stop, or a fault, ends it.
RSI_MOVECORR()

{_checked("ret", "RSI_OFF()", "RSIOK", "the end of RSI")}
{_checked("ret", "RSI_DELETE(context)", "RSIOK", "the context's end")}"""


def _of_krc2(plan: KrcPlan) -> str:
    handles = "containerID, hEthernet, hAxis" + (", hStop" if plan.stop else "")
    blocks = [
        f"CHAR configFile[{len(plan.ethernet_xml)}]\nDECL RSIERR err\nINT {handles}\n",
        _INI,
        _to_start(plan),
        f'configFile[] = "{plan.ethernet_xml}"\ncontainerID = 0\n',
        "; Counting of late replies begins with RSI: start the Robot Server now, then go on.\nHALT\n",
        _made("ST_ETHERNET(hEthernet, containerID, configFile[])", "the wire"),
        _made(f"ST_SETPARAM(hEthernet, eERXmaxLatePackages, {TIMEOUT_CYCLES})", "late replies allowed"),
        _made("ST_AXISCORR(hAxis, containerID)", "correction of the axes"),
        *(
            _made(f"ST_NEWLINK(hEthernet, {one.channel}, hAxis, {one.number})", f"{one.tag} to {one.axis}")
            for one in plan.corrections
        ),
        _made("ST_SETPARAM(hAxis, 1, 0)", "absolute: corrections count from the start pose"),
        "; limits of the total correction: parameters 2 to 13 below, 14 to 25 above",
        *(_limit(one) for one in plan.corrections),
        *_stop(plan),
        *_unlinked(plan),
        _made("ST_ON()", "RSI"),
        "; Moves by corrections until RSI is broken off.\nST_SKIPSENS()\n",
        _made("ST_OFF()", "the end of RSI"),
    ]
    return "\n".join(blocks)


def _stop(plan: KrcPlan) -> Iterable[str]:
    if plan.stop is not None:
        yield "; Unverified: known from one description alone; try it in T1 before you rely on it."
        yield _made(
            f"ST_BREAKMOVE(hStop, containerID, hEthernet, {plan.stop.channel})",
            f"{plan.stop.tag} ends the motion",
        )


def _limit(one: Correction) -> str:
    lower = f"ST_SETPARAM(hAxis, {one.number + 1}, {written(one.lower)})"
    upper = f"ST_SETPARAM(hAxis, {one.number + 13}, {written(one.upper)})"
    what = f"{one.axis} [{one.unit}]"
    return "\n".join(_made(call, what) for call in (lower, upper))


def _unlinked(plan: KrcPlan) -> Iterable[str]:
    for direction, signals in (("input", plan.inputs), ("output", plan.outputs)):
        for signal in signals:
            yield (
                f"; {signal.tag} ({signal.name}), {direction} {signal.channel} on the wire, is linked to nothing: "
                "see the manual\n"
            )


def _made(call: str, what: str) -> str:
    return _checked("err", call, "#RSIOK", what)


def _checked(variable: str, call: str, good: str, what: str) -> str:
    return f"{variable} = {call} ; {what}\nIF ({variable} <> {good}) THEN\n  HALT\nENDIF\n"
