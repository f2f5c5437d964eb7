"""The `*_ethernet.xml`: what is on the wire. Emulator and Robot Server load the very same file."""

from __future__ import annotations

from xml.sax.saxutils import escape, quoteattr

from deltaq_deploy.krc.header import header, xml_comment
from deltaq_deploy.krc.plan import KrcPlan, Signal
from deltaq_protocol.rsi.ethernet_xml import parse_ethernet_xml


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
