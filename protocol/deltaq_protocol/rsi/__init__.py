"""Telegrams of KUKA's Robot Sensor Interface (RSI), for both ends.

`SensorCodec` is the PC's end, `KrcCodec` the robot controller's; both are compiled from the same
`*_ethernet.xml` that the controller loads, and both speak rad and m to their callers.
"""

from deltaq_protocol.rsi.axes import AxisMap, EthernetConfigError, TelegramError
from deltaq_protocol.rsi.ethernet_xml import Element, ElementType, EthernetConfig, load_ethernet_xml
from deltaq_protocol.rsi.krc_codec import KrcCodec, KrcReport, SensorTelegram
from deltaq_protocol.rsi.sensor_codec import KrcTelegram, SensorCodec

__all__ = [
    "AxisMap",
    "Element",
    "ElementType",
    "EthernetConfig",
    "EthernetConfigError",
    "KrcCodec",
    "KrcReport",
    "KrcTelegram",
    "SensorCodec",
    "SensorTelegram",
    "TelegramError",
    "load_ethernet_xml",
]
