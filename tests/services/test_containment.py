"""After an error that nobody foresaw a core is what it was before the message, holds the robot, and lives."""

import json
import logging
import socket
from dataclasses import replace
from itertools import islice
from random import Random

import numpy as np
import pytest
from gate_rig import CELL, REST_CYCLES, SMALL, Rig
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from injected import error_in_call
from remembered import remembered
from served import Server
from test_hli_core import Bench
from test_hli_snapshot import Day

from deltaq_protocol.guarded import Command
from deltaq_protocol.messages import Increment, IoRequest, Outcome, Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.hli.requests import BY_MODEL
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.sim.core import Sim

GATE = ("deltaq_services.sim", "deltaq_cell", "deltaq_protocol.setpoint_motion", "deltaq_protocol.receipts")

SERVER = ("deltaq_services.robot_server", "deltaq_services.phases", "deltaq_protocol.setpoint_motion")
HLI = ("deltaq_services.hli", "deltaq_services.rate_limit")
FIRST = 3
"""The first call that a message causes: those before it are `take` itself, and what it is to be put back to."""


class Overheard(Rig):
    """Both robots are driven and stopped, and each message is noted with what the gate was before it."""

    def __init__(self):
        self.heard = []
        super().__init__()
        self.sim.take = self.noted
        for number in range(12):
            for robot, dq in (("fr", SMALL), ("gr", (1e-5,) * 9)):
                cycle = self.servers[robot].state.cycle
                self.request(dq=dq, robot=robot, cycle=cycle, seq=2 * number)
                self.request(dq=dq, robot=robot, cycle=cycle, seq=2 * number + 1)
            if number == 4:
                self.command(kind="dry_run", robot="fr", dq=SMALL)
                self.command(kind="contact", contact="gripper_on_valves", allowed=True)
                self.command(kind="io", robot="gr", outputs={"gripper": True})
            if number == 6:
                self.command(kind="stop", robot="gr")
            if number == 9:
                self.command(kind="reset", robot="gr")
            self.cycle()
        del self.sim.take

    def noted(self, message):
        self.heard.append((self.sim.snapshot(), message))
        return Sim.take(self.sim, message)


@pytest.fixture(scope="module")
def overheard():
    return Overheard()


@pytest.fixture(scope="module")
def twin():
    return Sim(CELL, epoch=5)


def said(outputs):
    return [(output.topic.name, output.message.model_dump_json()) for output in outputs]


@given(data=st.data())
def test_after_any_failure_a_gate_is_as_before_the_message(overheard, twin, data):
    """Two gates fail on a message, one before it has begun; from there on both say the same, to the bit."""
    number = data.draw(st.integers(0, len(overheard.heard) - 6))
    before, message = overheard.heard[number]
    sim = overheard.sim
    twin.restore(before)
    with error_in_call(None, *GATE) as calls:
        twin.take(message)
    share = data.draw(st.floats(0, 1))
    for gate, call in ((sim, FIRST + int(share * (calls.count - FIRST))), (twin, FIRST)):
        gate.restore(before)
        with error_in_call(call, *GATE) as made:
            gate.take(message)
        assume(made.count >= call)  # what was placed already takes fewer
        assert gate.containment.failed
    assert twin.snapshot() == sim.snapshot()
    for _, later in overheard.heard[number + 1 : number + 6]:
        assert said(sim.take(later)) == said(twin.take(later))
    assert twin.snapshot() == sim.snapshot()


class Failing:
    """A gate that fails on one robot."""

    def __init__(self, gate, robot="fr"):
        self._gate, self._robot = gate, robot

    def decide(self, robot, others, request):
        if robot.name == self._robot:
            raise ZeroDivisionError("nobody foresaw it")
        return self._gate.decide(robot, others, request)


@pytest.fixture
def rig():
    return Rig()


def drive(rig, robot, dq):
    return rig.request(dq=dq, robot=robot, cycle=rig.servers[robot].state.cycle)


def test_a_gate_failure_on_one_robot_holds_only_that_robot(rig):
    for _ in range(5):
        drive(rig, "fr", SMALL), drive(rig, "gr", SMALL + (0.0,) * 3)
        rig.cycle()
    assert rig.state.phase is Phase.ENGAGED
    sound, rig.sim.gate = rig.sim.gate, Failing(rig.sim.gate)
    verdict = drive(rig, "fr", SMALL)
    assert (verdict.outcome, verdict.reasons[0].code) == (Outcome.REFUSED, ReasonCode.INTERNAL_ERROR)
    for _ in range(5):
        assert drive(rig, "gr", SMALL + (0.0,) * 3).outcome is Outcome.ADMITTED
        rig.cycle()
    assert (rig.state.phase, rig.state.reason) == (Phase.HELD, ReasonCode.INTERNAL_ERROR)
    assert rig.servers["gr"].state.phase is Phase.ENGAGED
    assert rig.sim.counters["internal_errors"] == 1
    rig.sim.gate = sound
    for _ in range(REST_CYCLES):
        rig.cycle()
    rig.command(kind="reset", robot="fr")
    rig.cycle(), rig.cycle()
    assert rig.state.phase is Phase.READY
    assert drive(rig, "fr", SMALL).outcome is Outcome.ADMITTED


def test_a_failing_dry_run_is_refused_and_holds_only_its_robot(rig):
    rig.sim.gate = Failing(rig.sim.gate)
    reply = rig.command(kind="dry_run", robot="fr", dq=SMALL)
    assert (reply.accepted, reply.code) == (False, ReasonCode.INTERNAL_ERROR)
    rig.cycle(), rig.cycle()
    assert (rig.state.phase, rig.state.reason) == (Phase.HELD, ReasonCode.INTERNAL_ERROR)
    assert rig.servers["gr"].state.phase is Phase.READY


def test_a_robot_with_failing_states_is_still_stopped(rig, monkeypatch):
    monkeypatch.setattr(rig.sim.robots["fr"].tracker, "observe", lambda _: 1 / 0)
    for _ in range(3):
        rig.cycle()
    assert (rig.state.phase, rig.state.reason) == (Phase.HELD, ReasonCode.INTERNAL_ERROR)
    assert rig.servers["gr"].state.phase is Phase.READY


def test_a_failing_stop_still_stops(rig, monkeypatch):
    monkeypatch.setattr(rig.sim.robots["gr"].orders, "answer_when_stopped", lambda _: 1 / 0)
    assert rig.command(kind="stop").code is ReasonCode.INTERNAL_ERROR
    rig.cycle(), rig.cycle()
    assert [server.state.phase for server in rig.servers.values()] == [Phase.HELD, Phase.HELD]


def test_a_traceback_is_logged_once_for_each_failing_place(rig, caplog):
    rig.sim.gate = Failing(rig.sim.gate)
    log = logging.getLogger("test")
    for _ in range(3):
        rig.cycle()
        rig.command(kind="dry_run", robot="fr", dq=SMALL)
        rig.sim.containment.log_once(log)
        rig.sim.robots["fr"].orders.standing_stop = None
    assert len(caplog.records) == 1
    assert "ZeroDivisionError: nobody foresaw it" in caplog.text
    assert "in decide\n" in caplog.text


@settings(max_examples=15)
@given(share=st.floats(0, 1))
def test_after_any_failure_in_a_cycle_the_robot_brakes_and_can_be_reset(share):
    rig = Rig()
    for _ in range(5):
        drive(rig, "fr", (-1e-3, *SMALL[1:])), drive(rig, "gr", (*SMALL, 0.0, 0.0, 0.0))
        rig.cycle()
    server = rig.servers["fr"]
    assert rig.state.phase is Phase.ENGAGED
    drive(rig, "fr", (-1e-3, *SMALL[1:]))
    server.take(rig.mail["fr"][0], rig.time_s)
    measured = Measurement(round(rig.time_s * 1000) + 12, rig.q["fr"], None)
    before, brake = server.snapshot(), server.motion.braked()
    with error_in_call(None, *SERVER) as calls:
        server.take(measured, rig.time_s)
    server.restore(before)
    with error_in_call(FIRST + int(share * (calls.count - FIRST)), *SERVER):
        (setpoint,) = server.take(measured, rig.time_s)
    assert server.counters["internal_errors"] == 1
    np.testing.assert_array_equal(setpoint.q_cmd, brake.q_cmd)
    rig.q["fr"] = setpoint.q_cmd
    assert (server.state.phase, server.state.reason) == (Phase.HELD, ReasonCode.INTERNAL_ERROR)
    for _ in range(REST_CYCLES):
        rig.cycle()
        assert drive(rig, "gr", (*SMALL, 0.0, 0.0, 0.0)).outcome is Outcome.ADMITTED
    assert not rig.sim.disbelieved
    rig.command(kind="reset", robot="fr")
    rig.cycle(), rig.cycle()
    assert rig.state.phase is Phase.READY


def test_a_robot_server_that_cannot_brake_leaves_the_brake_to_the_crash_brake(rig, monkeypatch):
    server = rig.servers["fr"]
    monkeypatch.setattr(server, "_watch", lambda _: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        server.take(Measurement(12, rig.q["fr"], None), rig.time_s)


def test_a_failing_admission_counts_as_lost(rig, monkeypatch):
    drive(rig, "fr", SMALL)
    monkeypatch.setattr(rig.servers["fr"]._admissions, "put", lambda *_: 1 / 0)
    rig.cycle()
    assert (rig.state.phase, rig.state.reason) == (Phase.HELD, ReasonCode.INTERNAL_ERROR)
    assert not np.any(rig.state.dq)


def but_streams(core):
    """What the HLI remembers, but for when each stream was heard."""
    return {name: value for name, value in remembered(core).items() if name not in ("_states", "_services")}


@settings(max_examples=20)
@given(seed=st.integers(0, 3), share=st.floats(0, 1))
def test_after_any_failure_the_hli_is_as_before_the_message(seed, share):
    day = Day(seed)
    core, random = day.core, Random(share)

    def failing():
        with error_in_call(random.randrange(1, 40), *HLI):
            return core.take(day.message(), day.now_s, day.clients[0])

    for _ in range(60):
        before = but_streams(core)
        outputs = core.contained(failing, day.now_s)
        if core.containment.failed:
            assert (but_streams(core), outputs) == (before, [])
        day.now_s += 0.004
    assert core.counters["internal_errors"] > 5


def test_a_failing_increment_is_reported_and_its_robot_held(monkeypatch):
    bench = Bench().ready()
    monkeypatch.setattr(bench.core.increments, "on_increment", lambda *_: 1 / 0)
    increment = Increment(robot="fr", seq=1, cycle=100, dq=(0.0,) * 6, lease=bench.token)
    for number in range(3):
        outputs = bench.core.contained(
            lambda: bench.core.take(increment, bench.now, bench.client),
            bench.now,
            ("fr",),
            bench.client,
            {"type": "increment", "robot": "fr", "seq": 1},
        )
        error = outputs[-1].message
        assert (error.code, error.request, error.seq) == (ReasonCode.INTERNAL_ERROR, "increment", 1)
        stops = [output.message for output in outputs if isinstance(output.message, Command)]
        assert len(stops) == (number == 0)  # it stands until the gate has answered
    bench.state(101, robot="gr")


def test_a_failing_line_is_answered_and_its_connection_continues(monkeypatch, caplog):
    monkeypatch.setitem(BY_MODEL, IoRequest, replace(BY_MODEL[IoRequest], answer=lambda *_: 1 / 0))
    with (
        Server() as server,
        socket.create_connection(("127.0.0.1", server.description.tcp_port), timeout=300) as sock,
    ):
        ask = b'{"type":"io","robot":"fr","outputs":{}}\n'
        sock.sendall(
            b'{"type":"hello","protocol":1,"client":"test"}\n' + ask + ask + b'{"type":"describe"}\n'
        )
        with sock.makefile() as lines:
            answers = [data for data in map(json.loads, islice(lines, 200)) if data["type"] != "state"]
            kinds = [data.get("code", data["type"]) for data in answers[:4]]
    assert kinds == ["welcome", "internal_error", "internal_error", "description"]
    assert server.hli.core.counters["internal_errors"] == 2
    assert caplog.text.count("ZeroDivisionError") == 1
