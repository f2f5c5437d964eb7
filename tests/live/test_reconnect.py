"""Nothing that was queued while a wire was down moves the robot: real processes, relays in the wires."""

import json
import socket
from contextlib import ExitStack, contextmanager

import pytest
from live_stack import live_stack
from small_cell import endpoint

from deltaq_protocol import topics
from deltaq_protocol.blocking import connect
from deltaq_protocol.codec import pack, unpack
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.messages import Increment, LeaseAction, LeaseReply, LeaseRequest, RobotState, Verdict
from deltaq_protocol.proof import Prover
from deltaq_protocol.session import open_session, subscribe_newest
from deltaq_testing.faults.panel import load_rsi_cell
from deltaq_testing.impairment.relay import TrafficUnit
from deltaq_testing.impairment.tcp import StreamFaults
from deltaq_testing.virtual_cell.parts import Link
from studies.live_faults.moving_cell import RelayPlacement, placed
from studies.live_faults.relay_process import RelayProcess

# tests/services hold it by day of HLI and gate, each alone
pytestmark = [pytest.mark.live, pytest.mark.nightly]

WHOLE, STALLED, CUT = StreamFaults(), StreamFaults(stalled=True), StreamFaults(cut=True)
TWO_SECONDS = 170
"""Cycles of 12 ms."""
STEP = [0.002, 0.0, 0.0, 0.0, 0.0, 0.0]
FLOOD = 300


class Stack:
    """A running cell whose wires to clients and between HLI and SIM go through relays."""

    def __init__(self, stack, lines, zenoh, gate):
        self.cell, self.live = stack.cell, stack
        self.lines, self.zenoh, self.gate = lines, zenoh, gate

    def made_ready(self):
        """Reset the floor robot, so that no hold hides what a queue might do; its setpoint."""
        self.live.wait_until_at_rest()
        if self.live.phase()[0] == "held":
            self.live.reset()
        return self.live.setpoint()

    def admitted(self):
        """Increments that the gate has admitted so far, also in part."""
        with connect(self.cell.hli) as running:
            counters = running.status().hli
        return counters.get("verdicts_admitted", 0) + counters.get("verdicts_scaled", 0)


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reconnect")
    with ExitStack() as relays:
        gate = []

        def rewired(services, file):
            loaded = load_rsi_cell(file)
            relay = placed(
                RelayPlacement(Link.HLI_SIM, TrafficUnit.BYTES), loaded.model.description, "fr", seed=0
            )
            gate.append(relays.enter_context(relay))
            return gate[0].with_relays(services, loaded, "fr", folder)

        stack = relays.enter_context(live_stack(folder, rewired=rewired))
        tcp = f"tcp/127.0.0.1:{stack.cell.tcp_port}"
        listens = [Endpoint.parse(endpoint()) for _ in range(2)]
        before = [
            relays.enter_context(RelayProcess(listen, Endpoint.parse(to), TrafficUnit.BYTES))
            for listen, to in zip(listens, (tcp, stack.cell.hli), strict=True)
        ]
        made = Stack(stack, *before, gate[0])
        made.lines_port, made.zenoh_endpoint = listens[0].port, str(listens[1])
        yield made


class Lines:
    """A client of JSON lines that moves the floor robot."""

    def __init__(self, sock):
        self.sock = sock
        self.stream = sock.makefile("rb")
        self.seq = 0
        self.say({"type": "hello", "protocol": 1, "client": "test"})

    def say(self, message):
        self.sock.sendall(json.dumps(message).encode() + b"\n")

    def acquire(self):
        self.say({"type": "lease", "robot": "fr", "action": "acquire"})

    def ask(self, cycle):
        self.seq += 1
        self.say({"type": "increment", "robot": "fr", "seq": self.seq, "cycle": cycle, "dq": STEP})

    def ask_for_ever(self, cycle):
        while True:
            self.ask(cycle)

    def next(self, *kinds):
        while True:
            message = json.loads(self.stream.readline())
            if message["type"] in kinds and message.get("robot") == "fr":
                return message

    def move(self, cycles):
        """Take the lease, and answer states until so many increments were admitted."""
        self.acquire()
        while cycles:
            message = self.next("state", "verdict")
            if message["type"] == "state":
                self.ask(message["cycle"])
            elif message["outcome"] in ("admitted", "scaled"):
                cycles -= 1
            elif message["reasons"][0]["code"] == "lease_not_held":
                self.acquire()  # whoever had it last may have left without a word
            else:  # an answer that came late is asked for again; a robot that is held stays so
                assert message["reasons"][0]["code"] != "held", message


@contextmanager
def lines(port):
    with socket.create_connection(("127.0.0.1", port), timeout=300) as sock:
        yield Lines(sock)


def test_lines_sent_into_a_cut_link_are_refused_as_stale_on_arrival(stack):
    with lines(stack.lines_port) as client:
        stack.made_ready()
        client.move(10)
        last = client.next("state")["cycle"]
        stack.lines.impair(STALLED)
        client.acquire()  # its old lease will have run out: a queue may well begin so
        first = client.seq + 1
        for _ in range(FLOOD):
            client.ask(last)
        stack.live.wait_cycles(TWO_SECONDS)
        rest, admitted = stack.made_ready(), stack.admitted()
        stack.lines.impair(WHOLE)
        verdicts = [client.next("verdict")]
        while verdicts[-1]["seq"] < client.seq:
            verdicts.append(client.next("verdict"))
        flooded = [verdict for verdict in verdicts if verdict["seq"] >= first]
        assert len(flooded) == FLOOD
        assert {verdict["outcome"] for verdict in flooded} == {"refused"}
        assert {verdict["reasons"][0]["code"] for verdict in flooded} == {"stale_cycle"}
        assert stack.admitted() == admitted
        assert (stack.live.setpoint() == rest).all()
        client.move(5)  # and what is fresh moves it


def test_a_cut_connection_leaves_neither_a_queue_nor_a_lease(stack):
    with lines(stack.lines_port) as client:
        stack.made_ready()
        client.move(10)
        last = client.next("state")["cycle"]
        stack.lines.impair(CUT)
        with pytest.raises(OSError, match=r"reset|Broken pipe"):
            client.ask_for_ever(last)
    stack.live.wait_for_reason("controller_lost")
    rest, admitted = stack.made_ready(), stack.admitted()
    stack.lines.impair(WHOLE)
    with lines(stack.lines_port) as again:
        again.ask(again.next("state")["cycle"])
        assert again.next("verdict")["reasons"][0]["code"] == "lease_not_held"
        again.acquire()
        again.ask(last)
        assert again.next("verdict")["reasons"][0]["code"] == "stale_cycle"
        assert stack.admitted() == admitted
        assert (stack.live.setpoint() == rest).all()


def test_increments_published_into_a_cut_link_never_move_the_robot(stack):
    stack.made_ready()
    key = {topic: topic.key("lab", robot="fr") for topic in (topics.INCREMENT, topics.LEASE, topics.VERDICT)}
    beside = open_session(connect=[stack.cell.hli], must_connect=True)
    session = open_session(connect=[stack.zenoh_endpoint], must_connect=True)
    try:
        states = subscribe_newest(session, topics.STATE.key("lab", robot="fr"))
        seen = beside.declare_subscriber(key[topics.VERDICT])
        lease = acquired(session, key[topics.LEASE])
        seq = 0

        def ask(cycle):
            nonlocal seq
            seq += 1
            increment = pack(Increment(robot="fr", seq=seq, cycle=cycle, dq=STEP))
            proof = Prover(lease).prove(key[topics.INCREMENT], increment)
            session.put(key[topics.INCREMENT], increment, attachment=proof)

        for _ in range(20):
            last = unpack(RobotState, states.recv().payload.to_bytes()).cycle
            ask(last)
        while unpack(Verdict, seen.recv().payload.to_bytes()).outcome not in ("admitted", "scaled"):
            pass
        stack.zenoh.impair(STALLED)
        before = seq
        for _ in range(FLOOD):
            ask(last)
        stack.live.wait_cycles(TWO_SECONDS)
        rest, admitted = stack.made_ready(), stack.admitted()
        stack.zenoh.impair(WHOLE)
        lease = acquired(session, key[topics.LEASE])  # the session has found its way again
        ask(last)
        arrived = []
        while not arrived or arrived[-1].seq < seq:
            verdict = unpack(Verdict, seen.recv().payload.to_bytes())
            arrived += [verdict] if verdict.seq > before else []
        assert {verdict.outcome for verdict in arrived} == {"refused"}
        assert arrived[-1].reasons[0].code == "stale_cycle"
        assert {verdict.reasons[0].code for verdict in arrived} <= {"stale_cycle", "lease_not_held"}
        assert stack.admitted() == admitted
        assert (stack.live.setpoint() == rest).all()
    finally:
        session.close()
        beside.close()


def acquired(session, key):
    request = pack(LeaseRequest(robot="fr", action=LeaseAction.ACQUIRE, client="test"))
    while True:
        for reply in session.get(key, payload=request, timeout=2.0):
            if reply.ok is not None and (told := unpack(LeaseReply, reply.ok.payload.to_bytes())).granted:
                return told.lease


def test_requests_that_wait_between_hli_and_gate_are_forgotten(stack):
    with lines(stack.cell.tcp_port) as client:
        stack.made_ready()
        client.move(10)
        stack.gate.impair(STALLED)
        end = client.next("state")["cycle"] + TWO_SECONDS
        while (cycle := client.next("state")["cycle"]) < end:
            client.ask(cycle)
        stack.live.wait_for_reason("hli_lost")
        rest, admitted = stack.live.setpoint(), stack.admitted()
        stack.gate.lift()
        assert (stack.made_ready() == rest).all()  # the reset went over the wire, after all that had waited
        stack.live.wait_cycles(20)
        assert stack.admitted() == admitted
        assert (stack.live.setpoint() == rest).all()
        client.move(5)
