"""Which files a KRC needs, where they belong on it, and how they get into a folder here."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

from deltaq_deploy.krc.context import rsi_model, rsi_xml, visual_list
from deltaq_deploy.krc.header import header, xml_comment
from deltaq_deploy.krc.plan import KrcFilesError, KrcPlan, Signal
from deltaq_deploy.krc.program import program
from deltaq_protocol.rsi.ethernet_xml import parse_ethernet_xml
from deltaq_protocol.rsi.judge import is_loopback

# The `*_ethernet.xml`: what is on the wire. Emulator and Robot Server load the very same file.


def ethernet_xml(plan: KrcPlan) -> str:
    """The text of the `*_ethernet.xml`.

    Raises:
        EthernetConfigError: a TAG or the address of the cell is none that such a file can have.
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


def notes_on(plan: KrcPlan) -> tuple[str, ...]:
    """Steps that remain to be done by hand."""
    notes = [
        "nothing here has been tried on a real controller of that version: read the files, and start in T1"
    ]
    if is_loopback(plan.address):
        notes.append(
            f"IP_NUMBER is {plan.address}, which no real KRC reaches: set driver.address to this machine's address on "
            "the robot's network, or give it with --address"
        )
    if plan.stop is None:
        notes.append("the cell names no driver.stop, so the PC cannot end the motion")
    loose = [signal.name for signal in (*plan.inputs, *plan.outputs) if signal.digital is None]
    if plan.krc == "krc2" and (plan.inputs or plan.outputs):
        notes.append(
            "digital signals are in the telegrams but linked to nothing on a KR C2: link them by the RSI manual"
        )
    elif loose:
        notes.append(
            f"{', '.join(loose)}: in the telegrams but linked to nothing; give the KRC's $IN or $OUT with "
            "--digital NAME=NUMBER"
        )
    if plan.krc == "krc2":
        notes.append("the number of decimals is left as the KR C2 has it: see it with `deltaq krc sniff`")
    return tuple(notes)


def write_files(files: tuple[KrcFile, ...], folder: Path, *, force: bool = False) -> None:
    """Write files into a folder, all or none.

    Raises:
        KrcFilesError: one is there already and `force` is not set, or the folder cannot be written to.
    """
    there = [file.name for file in files if (folder / file.name).exists()]
    if there and not force:
        raise KrcFilesError(
            f"{folder} has {', '.join(there)} already; take another folder, or --force to overwrite"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file in files:
            (folder / file.name).write_text(file.text, encoding="utf-8")
    except OSError as error:
        raise KrcFilesError(f"{folder}: cannot be written to: {error.strerror or error}") from error
