"""No message of any kind, however extreme its values, brings out an error that nobody foresaw."""

import contextlib
import json
import re
from collections import Counter
from random import Random

import numpy as np
import pytest
from console_bench import POSE, ConsoleBench
from extremes import Extremes, extreme, sent_and_read
from gate_rig import CELL, SMALL, Rig, bound
from hypothesis import given
from hypothesis import strategies as st
from krc_bench import Bench
from krc_side import FR, KrcSide
from test_hli_snapshot import ROBOTS, Day

from deltaq_emulator.faults import FaultyLink
from deltaq_emulator.panel import REQUESTS, Panel
from deltaq_emulator.recorder import CsvRecorder
from deltaq_protocol import topics
from deltaq_protocol.guarded import Health, Request, Supervision
from deltaq_protocol.messages import Outcome, Phase, RobotState, Verdict
from deltaq_protocol.rsi import TelegramError
from deltaq_protocol.topic import Party, Realm
from deltaq_services.console.commands import COMMANDS
from deltaq_services.robot_server.measurement import Measurement

pytestmark = [pytest.mark.long, pytest.mark.filterwarnings("error::RuntimeWarning")]
SEEDS = st.integers(0, 2**32)
CHANGED = 1
"""Changed messages of each kind and example."""
READ = Counter()
"""Valid messages that were taken, by kind; for people."""


class Moving(Rig):
    """Both robots are driven; where they are then is what each example begins with."""

    def __init__(self):
        super().__init__()
        for _ in range(8):
            for robot in self.servers:
                dq = (2e-4,) * len(self.q[robot])
                self.request(dq=dq, robot=robot, cycle=self.servers[robot].state.cycle)
            self.cycle()
        assert {server.state.phase for server in self.servers.values()} == {Phase.ENGAGED}
        self.gate = self.sim.snapshot()
        self.memories = {robot: server.snapshot() for robot, server in self.servers.items()}

    def to_the_gate(self):
        """A message of each kind that the gate takes, as it could come next."""
        for server in self.servers.values():
            yield server.state
            yield server.state.model_copy(update={"cycle": server.state.cycle + 1})
        request = Request(robot="fr", cycle=self.state.cycle, lease_epoch=1, seq=self.seq + 1, dq=SMALL)
        yield from (request, request.model_copy(update={"dq": None}))
        for kind in ("stop", "reset", "io", "dry_run", "contact"):
            fields = {"dry_run": {"robot": "fr", "dq": SMALL}, "contact": {"contact": "gripper_on_valves"}}
            yield bound(self.sim, kind=kind, outputs={"gripper": True}, **fields.get(kind, {}))


@pytest.fixture(scope="module")
def moving():
    return Moving()


@given(seed=SEEDS)
def test_the_gate_handles_every_extreme_message(moving, seed):
    random, sim = Random(seed), moving.sim
    sim.restore(moving.gate)
    limits = {
        name: robot.max_velocity * CELL.description.cycle_s for name, robot in CELL.description.robots.items()
    }
    sim.counters.clear()
    for template in [*moving.to_the_gate()]:
        for message in extreme(template, random, CHANGED):
            READ[type(message).__name__] += 1
            if random.random() < 0.8:
                sim.restore(moving.gate)
            for output in sim.take(message):
                sent_and_read(output.message)
                if output.topic is topics.ADMISSION:
                    dq = np.abs(output.message.dq)
                    assert (dq <= limits[output.robot] * (1 + 1e-6)).all(), message
            assert not sim.counters["internal_errors"], (message, sim.containment.traceback)
    sent_and_read(sim.snapshot())
    sim.nearest()


def test_every_message_type_of_the_gate_is_tested(moving):
    """A row of the table that is new has to be among them."""
    kinds = {
        row.message for row in topics.TOPICS if row.realm is Realm.GUARDED and Party.SIM in row.readers
    } - {Health, topics.AUDIT_ENTRY.message}
    moving.sim.restore(moving.gate)
    assert {type(message) for message in moving.to_the_gate()} == kinds


@given(seed=SEEDS)
def test_a_robot_server_handles_every_extreme_message(moving, seed):
    random, server, robot = Random(seed), moving.servers["fr"], CELL.description.robots["fr"]
    admission = next(
        output.message
        for output in moving.sim.take(next(iter(requests(moving))))
        if output.topic is topics.ADMISSION
    )
    moving.sim.restore(moving.gate)
    order = Supervision(robot="fr", epoch=5, cycle=1, cell=server.state.cell)
    for template in (admission, order):
        for message in extreme(template, random, CHANGED):
            READ[type(message).__name__] += 1
            server.restore(moving.memories["fr"])
            server.counters.clear()
            before = server.motion.q_cmd
            for number in range(3):
                server.take(message, float(number))
                (setpoint,) = server.take(Measurement(9000 + 12 * number, before, None), float(number))
                assert (robot.lower <= setpoint.q_cmd).all()
                assert (setpoint.q_cmd <= robot.upper).all()
                sent_and_read(server.state)
            assert not server.counters["internal_errors"], (message, server.containment.traceback)
    server.restore(moving.memories["fr"])


def requests(moving):
    moving.sim.restore(moving.gate)
    yield Request(robot="fr", cycle=moving.state.cycle, lease_epoch=1, seq=moving.seq + 1, dq=SMALL)


@pytest.fixture(scope="module", params=[1, 2])
def day(request):
    day = Day(request.param)
    for _ in range(80):
        day.core.take(day.message(), day.now_s, day.clients[0])
        day.now_s += 0.004
    day.memory = day.core.snapshot()
    return day


@given(seed=SEEDS)
def test_the_hli_handles_every_extreme_message(day, seed):
    random, core, memory = Random(seed), day.core, day.memory
    core.restore(memory)
    core.counters.clear()
    for make in [make for _, make in day.kinds().values()]:
        template = make(random.choice([*ROBOTS]))
        if isinstance(template, Exception):
            continue
        for message in extreme(template, random, CHANGED):
            READ[type(message).__name__] += 1
            core.restore(memory)
            for output in core.contained(lambda: core.take(message, day.now_s, day.clients[1]), day.now_s):  # noqa: B023
                sent_and_read(output.message)
            for robot in ROBOTS:
                core.contained(lambda: core.take(day.state(robot), day.now_s), day.now_s)  # noqa: B023
            assert not core.counters["internal_errors"], (message, core.containment.traceback)
    sent_and_read(core.status(day.now_s, Counter()))


@given(seed=SEEDS)
def test_the_console_handles_every_extreme_command(seed):
    random, bench = Random(seed), ConsoleBench()
    bench.states()
    desk = bench.browser()
    desk.takes()
    extremes = Extremes(COMMANDS, random)
    for _ in range(20 * CHANGED):
        command = extremes.valid()
        if random.random() < 0.5:
            command = extremes.changed(command)
        READ["console command"] += 1
        desk.raw(json.dumps(command))
        bench.tick(random.choice([0.0, 0.1]))
    bench.core.picture.frame(bench.now_s)


@given(seed=SEEDS)
def test_the_console_shows_all_messages_of_the_hli(seed):
    random, bench = Random(seed), ConsoleBench()
    bench.states()
    home = tuple(CELL.description.robots["fr"].home.tolist())
    state = RobotState(
        robot="fr", cycle=5, ipoc=5, time_s=1.0, q=home, q_cmd=home, tool=POSE, phase=Phase.ENGAGED
    )
    verdict = Verdict(robot="fr", cycle=5, seq=1, outcome=Outcome.SCALED, scale=0.5, dq=home)
    for template, take in (
        (state, bench.core.picture.take_state),
        (verdict, bench.core.picture.take_verdict),
    ):
        for message in extreme(template, random, 5 * CHANGED):
            READ[f"console {type(message).__name__}"] += 1
            take(message, bench.now_s)
            bench.tick(0.1)
            bench.core.picture.frame(bench.now_s)


@pytest.fixture(scope="module")
def side():
    return KrcSide().begin()


@given(seed=SEEDS)
def test_a_robot_server_handles_every_extreme_telegram(side, seed):
    random = Random(seed)
    for _ in range(20 * CHANGED):
        side.tick()
        datagram = with_extremes(side.own(), random)
        READ["telegram"] += 1
        with contextlib.suppress(TelegramError):
            side.hand(datagram)
        side.cycle()
        assert (np.abs(side.q - FR.home) < 1e-3).all()
    assert not side.counters["internal_errors"]


@given(seed=SEEDS)
def test_an_emulated_krc_handles_every_extreme_reply(seed):
    random, bench = Random(seed), Bench()
    for _ in range(20 * CHANGED):
        datagram = bench.krc.tick()
        if datagram is None:
            bench = Bench()
            continue
        READ["reply"] += 1
        bench.krc.receive(with_extremes(bench.reply(bench.pc.decode(datagram).ipoc), random))
        assert np.isfinite(bench.krc.sample.q).all()


@given(seed=SEEDS)
def test_the_panel_of_an_emulated_krc_handles_every_extreme_request(seed):
    random, bench = Random(seed), Bench()
    panel = Panel("fr", bench.krc, FaultyLink(1), FaultyLink(2), CsvRecorder(0.012, bench.n))
    extremes, answers = Extremes(REQUESTS, random), []
    for _ in range(20 * CHANGED):
        request = extremes.valid()
        if random.random() < 0.5:
            request = extremes.changed(request)
        READ["panel request"] += 1
        panel.take(json.dumps(request).encode(), answers.append)
        bench.krc.tick()
        panel.cycle_passed()
    assert all("ok" in json.loads(answer) for answer in answers)


def with_extremes(datagram, random):
    """The same with other numbers in some places."""
    places = [*re.finditer(rb'(?<=[">])-?[0-9.]+(?=["<])', datagram)]
    for place in sorted(
        random.sample(places, random.choice((1, 1, 3, len(places)))), key=lambda one: -one.start()
    ):
        datagram = datagram[: place.start()] + random.choice(TEXTS_OF_NUMBERS) + datagram[place.end() :]
    return datagram


TEXTS_OF_NUMBERS = tuple(
    b"0 -0.0 1e99 -1e99 9999999999999999e99 1e-99 1e308 1e400 4294967295 4294967296 18446744073709551616 nan inf "
    b"1e 0x1 -360 360.0001 1e6 00000000000000000000 .5 -.5e-9".split(b" ")
)
