"""Telegrams of a KRC whose robot stands."""

from __future__ import annotations

from deltaq_cell.description import RsiDescription
from deltaq_protocol.rsi import AxisMap, KrcCodec, KrcReport, load_ethernet_xml
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell

_FIRST_IPOC = 4_200_000
_POSE = (0.0,) * 6


def standing_telegrams(loaded: LoadedCell, robot: str, count: int) -> list[bytes]:
    """What the KRC of a robot sends in so many cycles while the robot stands at home."""
    description = loaded.model.description.robots[robot]
    driver, xml = description.driver, loaded.ethernet_xml(robot)
    assert isinstance(driver, RsiDescription)  # asked only of a robot on RSI
    assert xml is not None  # and so it has such a file
    axes = AxisMap.of(description.joint_names, description.units, driver.krc)
    codec = KrcCodec(load_ethernet_xml(xml), axes, driver.inputs, driver.outputs)
    q, inputs = description.home, dict.fromkeys(description.inputs, False)
    step = driver.ipoc_step or round(loaded.model.description.cycle_s * 1000)
    return [
        codec.encode(KrcReport(_FIRST_IPOC + cycle * step, q, q, _POSE, _POSE, 0, inputs))
        for cycle in range(count)
    ]
