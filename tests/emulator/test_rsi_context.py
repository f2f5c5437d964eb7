"""Contexts and programs in the forms that RSI 2, 3 and 4 have them."""

from pathlib import Path

import numpy as np
import pytest
import RSIPI
from krc_bench import Bench

from deltaq_emulator.context import NOTHING, parse_context_xml, parse_program, read_context
from deltaq_emulator.settings import KrcSettings, SettingsError
from deltaq_emulator.states import KrcState

RSI3 = """<?xml version="1.0" encoding="UTF-8" standalone="yes"?>
<RSIObjects xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">
  <RSIObject ObjType="ETHERNET" ObjTypeID="64" ObjID="ETHERNET1">
    <Parameters>
      <Parameter Name="ConfigFile" ParamID="1" ParamValue="fr_ethernet.xml" IsRuntime="false" />
      <Parameter Name="Timeout" ParamID="1" ParamValue="40" />
      <Parameter Name="Precision" ParamID="8" ParamValue="5" />
    </Parameters>
  </RSIObject>
  <RSIObject ObjType="AXISCORR" ObjTypeID="33" ObjID="AXISCORR1">
    <Inputs><Input InIdx="1" OutObjID="ETHERNET1" OutIdx="1" /></Inputs>
    <Parameters>
      <Parameter Name="LowerLimA1" ParamID="1" ParamValue="-2.5" />
      <Parameter Name="UpperLimA1" ParamID="13" ParamValue="7" />
    </Parameters>
  </RSIObject>
  <RSIObject ObjType="AXISCORRMON" ObjTypeID="82" ObjID="AXISCORRMON1">
    <Parameters><Parameter Name="MaxA1" ParamID="1" ParamValue="3" /></Parameters>
  </RSIObject>
</RSIObjects>
"""
RSI4 = """<?xml version="1.0" encoding="utf-8"?>
<RsiContext SchemaVersion="2.0.0" xmlns="RsiContext">
  <RsiObjects xmlns="RsiDriver">
    <RsiObject ObjTypeId="64" ObjType="Ethernet" ObjId="Ethernet_1">
      <Parameters><Parameter Name="Timeout" ParamId="0" ParamValue="40" />
        <Parameter Name="Precision" ParamId="7" ParamValue="5" /></Parameters>
    </RsiObject>
    <RsiObject ObjTypeId="33" ObjType="AxisCorr" ObjId="AxisCorr_1">
      <Parameters><Parameter Name="LowerLimA1" ParamId="0" ParamValue="-2.5" />
        <Parameter Name="UpperLimA1" ParamId="6" ParamValue="7" /></Parameters>
    </RsiObject>
    <RsiObject ObjTypeId="82" ObjType="AxisCorrMon" ObjId="AxisCorrMon_1">
      <Parameters><Parameter Name="MaxA1" ParamId="0" ParamValue="3" /></Parameters>
    </RsiObject>
  </RsiObjects>
</RsiContext>
"""
RSI2 = """DEF anything ( )
DECL RSIERR err
INT hEthernet, hAxis
err = ST_ETHERNET (hEthernet, 0, "fr_ethernet.xml")
err = ST_AXISCORR (hAxis, 0)
err = ST_SETPARAM (hEthernet, 2, 77)
err = st_setparam(haxis, 1, 1) ; 1 is relative
err = ST_SETPARAM (hAxis, 2, -2.5)
;err = ST_SETPARAM (hAxis, 14, 100)
err = ST_SETPARAM (hAxis, 14, 7)
err = ST_SETPARAM (hAxis, 20, 400)
END
"""


@pytest.mark.parametrize("text", [RSI3, RSI4, "\ufeff" + RSI3], ids=["RSI 3", "RSI 4", "byte order mark"])
def test_limits_monitors_and_ethernet_are_read_from_a_context(text: str) -> None:
    context = parse_context_xml(text.encode(), "fr.rsi.xml")
    settings = context.settings(KrcSettings())
    assert (settings.late_budget, settings.precision) == (40, 5)
    bench = Bench(("a1", "a2"), context=context)
    limits = context.limits(bench.pc.axes, settings)
    assert np.rad2deg(limits.lower) == pytest.approx([-2.5, -5.0])  # of A2 it says nothing
    assert np.rad2deg(limits.upper) == pytest.approx([7.0, 5.0])
    assert np.rad2deg(limits.monitor) == pytest.approx([3.0, 6.0])


def test_the_emulated_controller_clamps_and_stops_by_the_context() -> None:
    context = parse_context_xml(RSI3.encode(), "fr.rsi.xml")
    bench = Bench(("a1",), context=context)
    bench.drive(-5e-4 * k for k in range(200))
    assert np.rad2deg(bench.krc.sample.q_setpoint) == pytest.approx([-2.5])
    assert bench.krc.state is KrcState.RSI_RUNNING
    bench = Bench(("a1",), context=context)
    bench.drive(5e-4 * k for k in range(200))
    assert bench.krc.state is KrcState.STOPPED
    assert "correction of A1 is 3.0" in str(bench.krc.message)


def test_limits_and_mode_are_read_from_a_program_of_rsi_2() -> None:
    context = parse_program(RSI2, "fr.src")
    assert (context.lower, context.upper) == ({"A1": -2.5}, {"A1": 7.0, "E1": 400.0})
    bench = Bench(("e1", "a1"), krc="krc2", context=context)
    limits = context.limits(bench.pc.axes, bench.krc.settings)
    assert limits.upper == pytest.approx([0.4, np.deg2rad(7.0)])
    assert bench.krc.correction == "relative"


@pytest.mark.parametrize(
    ("call", "correction"),
    [
        ("RSI_ON(#RELATIVE)", "relative"),
        ("ret = RSI_ON (#ABSOLUTE, #IPO_FAST)", "absolute"),
        (";RSI_ON(#RELATIVE)", None),
    ],
)
def test_the_mode_is_read_from_a_program_of_rsi_3_and_later(call: str, correction: str | None) -> None:
    context = parse_program(f"DEF anything()\n{call}\nRSI_MOVECORR()\nEND", "fr.src")
    assert context.correction == correction
    assert not context.corrected


def test_without_files_the_settings_count() -> None:
    bench = Bench(("a1",), correction_limit_deg=20, monitor_limit_deg=30)
    limits = NOTHING.limits(bench.pc.axes, bench.krc.settings)
    assert np.rad2deg([limits.lower[0], limits.upper[0], limits.monitor[0]]) == pytest.approx([-20, 20, 30])
    assert read_context([]) == NOTHING


def test_several_files_are_one_application(tmp_path: Path) -> None:
    (tmp_path / "a.rsi.xml").write_text(RSI3)
    (tmp_path / "a.src").write_text("RSI_ON(#RELATIVE)")
    context = read_context([tmp_path / "a.rsi.xml", tmp_path / "a.src"])
    assert (context.timeout, context.correction, context.monitor) == (40, "relative", {"A1": 3.0})


def test_a_published_context_is_read() -> None:
    theirs = Path(RSIPI.__file__).parent / "contexts" / "RSIPI_Joints.rsi.xml"
    context = read_context([theirs])
    assert set(context.corrected) == {f"A{i}" for i in range(1, 7)}
    assert set(context.upper.values()) == {10.0}
    assert (context.timeout, context.precision) == (100, 1)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("-2.5", "left", "fr.rsi.xml: AXISCORR: LowerLimA1 is 'left', allowed is a number"),
        ("-2.5", "nan", "LowerLimA1 is 'nan', allowed is a number"),
        ("-2.5", "1", "correction of A1 is limited to 1 … 7; 0, where RSI starts, must lie within"),
        ('"40"', '"4.5"', "ETHERNET: Timeout is 4.5, allowed is 0 to"),
        ('"5"', '"0"', "ETHERNET: Precision is 0, allowed is 1 to 9"),
        ("RSIObject ", "Thing ", "is no XML document"),
        ("<RSIObjects", "<Roots><RSIObjects", "is no XML document"),
    ],
)
def test_a_context_that_cannot_be_used_is_refused_with_the_place(old: str, new: str, message: str) -> None:
    with pytest.raises(SettingsError, match=r"fr\.rsi\.xml") as caught:
        parse_context_xml(RSI3.replace(old, new).encode(), "fr.rsi.xml")
    assert message in str(caught.value)


def test_missing_files_and_other_formats_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"none\.rsi\.xml: cannot be read"):
        read_context([tmp_path / "none.rsi.xml"])
    with pytest.raises(SettingsError, match="the outermost element is <ROOT>"):
        parse_context_xml(b"<ROOT/>", "fr_ethernet.xml")
    with pytest.raises(SettingsError, match=r"fr\.src:3: ST_SETPARAM of hAxis is 'lower\[i\]'"):
        parse_program("DEF x()\nST_AXISCORR(hAxis, 0)\nST_SETPARAM(hAxis, 2, lower[i])\nEND", "fr.src")


def test_an_axis_without_a_correction_object_is_named() -> None:
    with pytest.raises(SettingsError, match="no correction object for E1; add AXISCORR"):
        Bench(("e1", "a1"), context=parse_context_xml(RSI3.encode(), "fr.rsi.xml"))
