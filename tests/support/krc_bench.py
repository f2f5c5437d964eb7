"""An emulated controller in virtual time and a PC that answers it, for tests."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from deltaq_cell.description import JointDescription, RobotDescription, RsiDescription, ServoLag
from deltaq_emulator.context import NOTHING, Context
from deltaq_emulator.krc import Krc
from deltaq_emulator.settings import PROFILES, KrcSettings
from deltaq_protocol.rsi import AxisMap, EthernetConfig, KrcTelegram, SensorCodec
from deltaq_protocol.rsi.ethernet_xml import parse_ethernet_xml

CYCLE_S = 0.012
NO_LAG = ServoLag(dead_time_s=0.0, natural_frequency_rad_s=1e4)
WIDE_OPEN = {
    "correction_limit_deg": 720,
    "correction_limit_mm": 10_000,
    "monitor_limit_deg": 730,
    "monitor_limit_mm": 10_010,
    "precision": 6,
}


def element(tag: str, kind: str = "DOUBLE", index: object = "INTERNAL", hold_on: int = 1) -> str:
    return f'<ELEMENT TAG="{tag}" TYPE="{kind}" INDX="{index}" HOLDON="{hold_on}"/>'


def make_config(
    joints: tuple[str, ...], hold_on: int = 1, port: int = 49152, arm: str = "AK"
) -> EthernetConfig:
    tags = [f"{arm if joint[0] == 'a' else 'EK'}.{joint.upper()}" for joint in joints]
    return parse_ethernet_xml(
        f"<ROOT><CONFIG><IP_NUMBER>127.0.0.1</IP_NUMBER><PORT>{port}</PORT><SENTYPE>ImFree</SENTYPE>"
        "<ONLYSEND>FALSE</ONLYSEND></CONFIG><SEND><ELEMENTS>"
        + "".join(element(f"DEF_{name}") for name in ("RIst", "AIPos", "ASPos", "EIPos", "ESPos"))
        + element("DEF_Delay", "LONG")
        + element("Di.01", "BOOL", 1)
        + "</ELEMENTS></SEND><RECEIVE><ELEMENTS>"
        + element("DEF_EStr", "STRING", hold_on=0)
        + "".join(element(tag, index=i, hold_on=hold_on) for i, tag in enumerate(tags, start=1))
        + element("Do.01", "BOOL", 20, hold_on)
        + element("Stop", "BOOL", 21, hold_on)
        + "</ELEMENTS></RECEIVE></ROOT>"
    )


def make_robot(joints: tuple[str, ...], servo_lag: ServoLag = NO_LAG, **driver: Any) -> RobotDescription:
    revolute = JointDescription(
        home_deg=0, lower_deg=-100, upper_deg=90, max_velocity_deg_s=156, max_acceleration_rad_s2=10
    )
    prismatic = JointDescription(
        home_m=0, lower_m=-0.5, upper_m=1.5, max_velocity_m_s=0.5, max_acceleration_m_s2=2
    )
    return RobotDescription(
        model="kr16",
        server="tcp/127.0.0.1:1",
        driver=RsiDescription(
            kind="rsi",
            port=49152,
            ethernet_xml="none.xml",
            inputs={"closed": "Di.01"},
            outputs={"gripper": "Do.01"},
            **({"stop": "Stop"} | driver),
        ),
        joints={joint: revolute if joint[0] == "a" else prismatic for joint in joints},
        servo_lag=servo_lag,
        inputs=("closed",),
        outputs=("gripper",),
    )


def forward(q: np.ndarray) -> np.ndarray:
    """A tool that stands at 1 m and moves along x by 1 m per rad or m of the first joint."""
    T = np.eye(4)
    T[:3, 3] = (1.0 + q[0], 0.0, 0.5)
    return T


class Bench:
    """An emulated controller and a PC that answers it."""

    def __init__(
        self,
        joints: tuple[str, ...] = tuple(f"a{i}" for i in range(1, 7)),
        krc: str = "krc4",
        hold_on: int = 1,
        servo_lag: ServoLag = NO_LAG,
        cycle_s: float = CYCLE_S,
        q_start: np.ndarray | None = None,
        driver: Mapping[str, Any] = MappingProxyType({}),
        context: Context = NOTHING,
        **settings: Any,
    ) -> None:
        self.config = make_config(joints, hold_on)
        self.robot = make_robot(joints, servo_lag, **driver)
        self.profile = PROFILES[krc]
        axes = AxisMap.of(self.robot.joint_names, self.robot.units, self.profile.name)
        self.pc = SensorCodec(self.config, axes, self.robot.driver.inputs, self.robot.driver.outputs)
        krc_settings = context.settings(KrcSettings(**(WIDE_OPEN | settings)))
        self.krc = Krc(
            self.robot,
            cycle_s,
            self.config,
            self.profile,
            np.zeros(len(joints)) if q_start is None else q_start,
            forward,
            krc_settings,
            limits=context.limits(axes, krc_settings),
        )
        self.n = len(joints)

    def cycle(self, correction: object = 0.0, stop: bool = False, **outputs: bool) -> KrcTelegram:
        """A cycle with a telegram and its reply; a number is the correction of every joint."""
        datagram = self.krc.tick()
        assert datagram is not None, self.krc.message
        telegram = self.pc.decode(datagram)
        reply = self.reply(telegram.ipoc, correction, **outputs)
        self.krc.receive(reply.replace(b"<Stop>0", b"<Stop>%d" % stop))
        return telegram

    def drive(self, corrections: Iterable[object]) -> int:
        """Cycles with these corrections until RSI stops; returns how many it took."""
        sent = 0
        for correction in corrections:
            datagram = self.krc.tick()
            if datagram is None:
                return sent
            self.krc.receive(self.reply(self.pc.decode(datagram).ipoc, correction))
            sent += 1
        self.krc.tick()
        return sent

    def reply(self, ipoc: int, correction: object = 0.0, **outputs: bool) -> bytes:
        return self.pc.encode(ipoc, np.broadcast_to(np.asarray(correction, float), (self.n,)), outputs)

    def silent(self, cycles: int = 1) -> bytes | None:
        """Cycles without a reply; returns the last telegram."""
        datagram = None
        for _ in range(cycles):
            datagram = self.krc.tick()
        return datagram

    def count(self, name: str) -> int:
        """A counter as of the next cycle."""
        self.krc.tick()
        return self.krc.sample.counters[name]
