"""What follows from the file that a KRC has loaded: telegrams, and the brake after a crash."""

from __future__ import annotations

import math
from pathlib import Path

from deltaq_cell.description import CellDescription, RsiDescription
from deltaq_protocol.rsi import AxisMap, SensorCodec, load_ethernet_xml
from deltaq_protocol.rsi.sensor_codec import MAX_TELEGRAM_BYTES
from deltaq_protocol.rsi.usual_telegram import usual_telegram
from deltaq_services.robot_server.crash_brake.core import CrashPlan


def sensor_codec(cell: CellDescription, robot: str, ethernet_xml: Path) -> SensorCodec:
    """The PC's telegrams of a robot, from the file that its KRC has loaded."""
    description = cell.robots[robot]
    assert isinstance(description.driver, RsiDescription)  # asked only of robots that speak RSI
    return SensorCodec(
        load_ethernet_xml(ethernet_xml),
        AxisMap.of(description.joint_names, description.units, description.driver.krc),
        description.driver.inputs,
        description.driver.outputs,
        description.driver.stop,
    )


def crash_plan(cell: CellDescription, robot: str, ethernet_xml: Path) -> CrashPlan:
    """What has to be known to brake a robot whose Robot Server has died, from the file that its KRC has loaded."""
    description = cell.robots[robot]
    driver = description.driver
    assert isinstance(driver, RsiDescription)  # asked only of robots that speak RSI
    codec = sensor_codec(cell, robot, ethernet_xml)
    pattern, programmed = usual_telegram(load_ethernet_xml(ethernet_xml))
    template, places = codec.template
    return CrashPlan(
        pattern=pattern,
        elements=programmed,
        most_bytes=MAX_TELEGRAM_BYTES,
        template=template.decode(),
        places=places,
        commanded=tuple(codec.axes.commanded.tolist()),
        outputs=len(driver.outputs),
        most=tuple((description.max_velocity * cell.cycle_s).tolist()),
        cycle_s=cell.cycle_s,
        silence_s=cell.gate.krc_timeout_s,
        lag_cycles=math.ceil(cell.gate.servo_lag_s / cell.cycle_s),
        has_stop=driver.stop is not None,
    )
