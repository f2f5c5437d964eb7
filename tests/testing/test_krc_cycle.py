"""A KRC that does not tick as its cell says drives nothing; its arm is judged in seconds of its own record."""

import numpy as np
import pytest
from krc_side import CELL, XML, KrcSide

from deltaq_cell.description import ServoLag
from deltaq_cell.robot import RobotModel
from deltaq_emulator.faults import FaultyLink, LinkFaults
from deltaq_emulator.krc import Krc
from deltaq_emulator.settings import PROFILES, KrcSettings
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.rsi import load_ethernet_xml
from deltaq_services.phases import MAY_MOVE

ASKED = np.deg2rad([10.0, 0, 0, 0, 0, 0])
"""Speed that the client asks for [rad/s]."""
QUICK = ServoLag(dead_time_s=0.004, natural_frequency_rad_s=1500)
"""Drives whose lag hides no other cycle from the probe."""


def cell_at(cycle_s):
    robot = CELL.robots["fr"]
    driver = robot.driver.model_copy(update={"krc": "krc4"})
    robots = {**CELL.robots, "fr": robot.model_copy(update={"driver": driver})}
    return CELL.model_copy(update={"robots": robots, "cycle_s": cycle_s})


class Ticking(KrcSide):
    """An emulated KRC with a cycle of its own before a Robot Server, a gate that admits the speed that is asked for.

    Attributes:
        record: (n,) setpoint of the drives in each of the KRC's cycles [rad].
        pace: how many times as fast as it says the KRC ticks.
    """

    def __init__(self, cell_s, krc_s, faults=None, **settings):
        super().__init__(cell=cell_at(cell_s), xml=XML)
        robot = self.cell.robots["fr"]
        model = RobotModel(robot, "fr")
        loaded = KrcSettings.load().model_copy(update={"late_budget": 10_000, **settings})
        self.krc = Krc(
            robot.model_copy(update={"servo_lag": QUICK}),
            krc_s,
            load_ethernet_xml(XML),
            PROFILES["krc4"],
            robot.home,
            model.forward,
            loaded,
        )
        self.wire = FaultyLink(seed=3)
        self.wire.faults = faults or LinkFaults()
        self.record, self.pace, self.pauses = [], 1.0, 0.0

    def run(self, seconds):
        begin_s = sent_s = self.time_s
        while self.time_s < begin_s + seconds:
            if self.time_s >= sent_s - 1e-9:
                datagram, ticked_s = self.krc.tick(), self.time_s
                self.record.append(self.krc.sample.q_setpoint)
                sent_s += self.krc.cycle_s / self.pace
                # a pause of the wire: what is sent meanwhile comes in one burst
                paused = self.pauses and self.time_s % 1.0 < self.pauses
                due_s = np.ceil(self.time_s) - 1.0 + self.pauses if paused else self.time_s
                if datagram is not None:
                    self.wire.put(due_s, datagram)
            for datagram in self.wire.take(self.time_s):
                reply = self.answer(datagram, self._admitted())
                if reply is not None:
                    self.krc.receive(reply, self.time_s - ticked_s)
            self.time_s += 0.001
        return self

    def _admitted(self):
        state = self.server.state
        if state is None or state.phase not in MAY_MOVE:
            return None
        cycle_s = self.cell.cycle_s
        most = 0.99 * self.cell.robots["fr"].max_acceleration * cycle_s**2
        wanted = ASKED * cycle_s - np.array(state.dq)
        return self.admission(np.array(state.dq) + np.clip(wanted, -most, most))

    @property
    def fastest(self):
        """Largest speed of a joint, by the record in seconds [rad/s], the probe included."""
        return float(np.abs(np.diff(self.record, axis=0)).max() / self.krc.cycle_s * self.pace)

    @property
    def reason(self):
        return None if self.server.state is None else self.server.state.reason


@pytest.mark.parametrize(
    ("cell_s", "krc_s", "settings", "told"),
    [
        (0.012, 0.004, {}, "ticks every 4.0 ms by its IPOC and 4.0 ms by the clock, the cell says 12.0 ms"),
        (0.012, 0.004, {"ipoc_step": 1}, "ticks every 4.0 ms by the clock, the cell says 12.0 ms"),
        (0.012, 0.004, {"ipoc_step": 12}, "ticks every 12.0 ms by its IPOC and 4.0 ms by the clock"),
        (0.004, 0.012, {}, "ticks every 12.0 ms by its IPOC and 12.0 ms by the clock, the cell says 4.0 ms"),
    ],
)
def test_a_krc_with_another_cycle_is_held_with_its_reason(cell_s, krc_s, settings, told):
    krc = Ticking(cell_s, krc_s, **settings).run(4.0)
    assert (krc.server.state.phase, krc.reason) == (Phase.HELD, ReasonCode.CYCLE_MISMATCH)
    assert told in krc.server.detail
    assert krc.counters["admissions"] == 0
    seen_at_once = (cell_s, settings) == (0.012, {})
    assert np.abs(krc.record - krc.record[0]).max() <= (
        0.0 if seen_at_once else np.deg2rad(0.04)
    )  # of the probe
    krc.resets += 1
    krc.run(0.5)
    assert krc.reason is ReasonCode.CYCLE_MISMATCH
    assert krc.server.state.resets == krc.resets  # taken for given


@pytest.mark.parametrize("cycle_s", [0.012, 0.004])
@pytest.mark.parametrize(
    ("faults", "pauses"),
    [
        (LinkFaults(), 0.0),
        (LinkFaults(jitter_s=0.02, keeps_order=True), 0.0),
        (LinkFaults(drop=0.05, duplicate=0.1, reorder=0.1), 0.0),
        (LinkFaults(), 0.2),
    ],
    ids=["clean", "jitter", "lossy", "bursts"],
)
def test_jitter_losses_and_bursts_are_not_another_cycle(cycle_s, faults, pauses):
    krc = Ticking(cycle_s, cycle_s).run(2.0)
    assert krc.server.state.phase in MAY_MOVE
    krc.wire.faults, krc.pauses = faults, pauses
    krc.run(4.0)
    assert krc.counters["held_cycle_mismatch"] == 0
    assert krc.fastest <= 1.02 * ASKED.max()
    assert krc.record[-1][0] - krc.record[0][0] > 0.3 * 4.0 * ASKED[0]


def test_a_slow_machine_is_not_another_cycle():
    krc = Ticking(0.004, 0.004)
    krc.pace = 4.0 / 7.2
    krc.run(3.0)
    assert krc.server.state.phase in MAY_MOVE
    assert krc.counters["held_cycle_mismatch"] == 0
    assert krc.fastest <= ASKED.max()


def test_a_krc_that_becomes_faster_is_held():
    krc = Ticking(0.012, 0.012, ipoc_step=1).run(3.0)
    assert krc.server.state.phase in MAY_MOVE
    krc.pace = 3.0
    krc.run(0.25)
    assert (krc.server.state.phase, krc.reason) == (Phase.HELD, ReasonCode.CYCLE_MISMATCH)
    assert "ticks every 4.0 ms by the clock, the cell says 12.0 ms" in krc.server.detail
