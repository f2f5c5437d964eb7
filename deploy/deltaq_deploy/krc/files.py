"""The files of a KRC: their texts, their destination on the controller, and writing them into a folder."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

from deltaq_deploy.krc.context import rsi_model, rsi_xml, visual_list
from deltaq_deploy.krc.plan import (
    TIMEOUT_CYCLES,
    Correction,
    KrcFilesError,
    KrcPlan,
    Signal,
    Start,
    header,
    written,
    xml_comment,
)
from deltaq_protocol.rsi.ethernet_xml import parse_ethernet_xml
from deltaq_protocol.rsi.judge import is_loopback

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
    """The text of the `.src`: starts RSI and ends it.

    KR C4: after the calls of RSI 3 and later as published programs have them. KR C2: after a program that has run on
    one (ST_ETHERNET, ST_AXISCORR, ST_NEWLINK, ST_SETPARAM, ST_ON, ST_SKIPSENS, ST_OFF); ST_BREAKMOVE is known from one
    description alone.
    """
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


# The `*_ethernet.xml`: the layout of telegrams. Emulator and Robot Server load the same file.


def ethernet_xml(plan: KrcPlan) -> str:
    """The text of the `*_ethernet.xml`.

    Raises:
        EthernetConfigError: such a file cannot have a TAG or the address of the cell.
    """
    internal = ["DEF_RIst", "DEF_AIPos", "DEF_ASPos"]
    if plan.external:
        internal += ["DEF_EIPos", "DEF_ESPos"]
    sent = [_element(tag, "DOUBLE", "INTERNAL") for tag in internal]
    sent.append(_element("DEF_Delay", "LONG", "INTERNAL"))
    sent += _digital(plan.inputs, "digital inputs; the cell's driver.inputs names them by TAG", sent=True)
    received = [_element(one.tag, "DOUBLE", one.channel, hold_on=True) for one in plan.arm]
    if plan.external:
        received.append("<!-- inputs 7 and up of the axis correction object -->")
        received += [_element(one.tag, "DOUBLE", one.channel, hold_on=True) for one in plan.external]
    received += _digital(
        plan.outputs, "digital outputs; the cell's driver.outputs names them by TAG", sent=False
    )
    if plan.stop is not None:
        received += _digital((plan.stop,), "ends the motion on the controller's side", sent=False)
    comment = [
        *header(plan, "RSI over Ethernet"),
        "Emulator and Robot Server load this file as well: what is changed here is changed for all of them.",
        "PROTOCOL and UNIT are for a KR C2 (Ethernet RSI XML); RSI 3 and later do without.",
    ]
    text = f"""\
{xml_comment(comment)}<ROOT>
   <CONFIG>
      <IP_NUMBER>{escape(plan.address)}</IP_NUMBER>
      <PORT>{plan.port}</PORT>
      <PROTOCOL>UDP</PROTOCOL>
      <SENTYPE>ImFree</SENTYPE>
      <ONLYSEND>FALSE</ONLYSEND>
   </CONFIG>
   <!-- From the controller, in this order; IPOC always comes last and is not listed. -->
   <SEND>
      <ELEMENTS>
{_indented(sent)}
      </ELEMENTS>
   </SEND>
   <!-- To the controller. Corrections are absolute, and HOLDON 1 keeps the last one when a telegram is late: with
        HOLDON 0 the robot would jump back to where RSI was started. -->
   <RECEIVE>
      <ELEMENTS>
{_indented(received)}
      </ELEMENTS>
   </RECEIVE>
</ROOT>
"""
    parse_ethernet_xml(text, plan.ethernet_xml)
    return text


def _digital(signals: tuple[Signal, ...], comment: str, *, sent: bool) -> list[str]:
    if not signals:
        return []
    elements = [_element(one.tag, "BOOL", one.channel, hold_on=not sent) for one in signals]
    return [f"<!-- {comment} -->", *elements]


def _element(tag: str, kind: str, index: int | str, hold_on: bool = False) -> str:
    tail = ' HOLDON="1"' if hold_on else ""
    return f'<ELEMENT TAG={quoteattr(tag)} TYPE="{kind}" INDX="{index}" UNIT="0"{tail} />'


def _indented(lines: list[str]) -> str:
    return "\n".join(f"         {line}" for line in lines)


PROGRAM_FOLDER = r"C:\KRC\ROBOTER\KRC\R1\Program"
SENSOR_FOLDER = r"C:\KRC\ROBOTER\Config\User\Common\SensorInterface"
INIT_FOLDER = r"C:\KRC\ROBOTER\INIT"
"""Where a KR C2 looks for the files that ST_ETHERNET names."""


@dataclass(frozen=True)
class KrcFile:
    """A file for a KRC.

    Attributes:
        name: of the file.
        text: its contents.
        copy_to: folder on the controller; empty for files that people read.
        what: its purpose.
    """

    name: str
    text: str
    copy_to: str
    what: str


def files_of(plan: KrcPlan) -> tuple[KrcFile, ...]:
    """The files that the plan's robot needs.

    Raises:
        EthernetConfigError: a TAG or an address of the cell is none that a KRC's file can have.
    """
    sensor = INIT_FOLDER if plan.krc == "krc2" else SENSOR_FOLDER
    files = [
        KrcFile(plan.ethernet_xml, ethernet_xml(plan), sensor, "what is on the wire"),
        KrcFile(f"{plan.program}.src", program(plan), PROGRAM_FOLDER, "the program that runs RSI"),
    ]
    if plan.rsi == 3:
        files += [
            KrcFile(f"{plan.program}.rsi.xml", rsi_xml(plan), sensor, "objects, links and limits"),
            KrcFile(f"{plan.program}.rsi", rsi_model(plan), sensor, "the same, as RSI Visual edits it"),
        ]
    if plan.rsi == 4:
        name = f"{plan.program}_rsi_visual.txt"
        files.append(
            KrcFile(name, visual_list(plan), "", f"from which {plan.program}.rsix is built in RSI Visual")
        )
    return tuple(files)


def notes_on(plan: KrcPlan) -> Iterator[str]:
    """Steps that remain to be done by hand."""
    yield "nothing here has been tried on a real controller of that version: read the files, and start in T1"
    if is_loopback(plan.address):
        yield (
            f"IP_NUMBER is {plan.address}, which no real KRC reaches: set driver.address to this machine's address on "
            "the robot's network, or give it with --address"
        )
    if plan.stop is None:
        yield "the cell names no driver.stop, so the PC cannot end the motion"
    loose = [signal.name for signal in (*plan.inputs, *plan.outputs) if signal.digital is None]
    if plan.krc == "krc2" and (plan.inputs or plan.outputs):
        yield "digital signals are in the telegrams but linked to nothing on a KR C2: link them by the RSI manual"
    elif loose:
        yield (
            f"{', '.join(loose)}: in the telegrams but linked to nothing; give the KRC's $IN or $OUT with "
            "--digital NAME=NUMBER"
        )
    if plan.krc == "krc2":
        yield "the number of decimals is the KR C2's own setting: check it with `deltaq krc sniff`"


def write_files(files: tuple[KrcFile, ...], folder: Path, *, force: bool = False) -> None:
    """Write files into a folder, all or none.

    Raises:
        KrcFilesError: one is there already and `force` is not set, or the folder cannot be written to.
    """
    there = [file.name for file in files if (folder / file.name).exists()]
    if there and not force:
        raise KrcFilesError(
            f"{folder} has {', '.join(there)} already; choose another folder, or --force to overwrite"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file in files:
            (folder / file.name).write_text(file.text, encoding="utf-8")
    except OSError as error:
        raise KrcFilesError(f"{folder}: cannot be written to: {error.strerror or error}") from error
