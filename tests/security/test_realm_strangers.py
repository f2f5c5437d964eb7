"""The guarded realm on one machine: the kernel keeps other users out, envelopes refuse what is old or replaced."""

import contextlib
import json
import os
import sys
import time
from pathlib import Path

import pytest
import zenoh
from lockstep_realm import LockstepRealm
from ran import ran

from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.session import open_session
from deltaq_services.guarded_realm import guarded_links

STEP = 1e-4  # [rad] a cycle
CYCLES = 20
NOBODY = 65534

STRANGER = """
import json, os, sys
user, *links = json.loads(sys.argv[1])
import zenoh
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.session import open_session
os.setgroups([]); os.setgid(user); os.setuid(user)
got = []
for link in links:
    path = link.partition("/")[2]
    try:
        os.listdir(os.path.dirname(path)); got.append("listed")
    except PermissionError:
        pass
    try:
        os.stat(path); got.append("found")
    except PermissionError:
        pass
    try:
        open_session(connect=[link], must_connect=True); got.append("connected")
    except ServiceUnreachableError:
        pass
print(json.dumps([os.geteuid(), got]))
"""


@pytest.fixture
def realm(tmp_path, lasting_links):
    realm = LockstepRealm(tmp_path)
    yield realm
    realm.close()


class Insider:
    """A process of the same user that repeats what it has recorded; the kernel does not keep it out."""

    def __init__(self, cell):
        self._session = open_session(connect=list(guarded_links(cell).values()), must_connect=True)

    def repeat(self, recording):
        for key, enclosed in recording:
            self._session.put(key, enclosed, congestion_control=zenoh.CongestionControl.BLOCK)

    def close(self):
        self._session.close()


@pytest.fixture
def insider(realm):
    insider = Insider(realm.description)
    yield insider
    insider.close()


def recorded_motion(realm):
    """A realm in motion, recorded; without what came before, of which the gate's ring could not hold so much."""
    realm.recording.clear()
    for _ in range(CYCLES):
        realm.cycle({"fr": STEP})
    for name in ("state", "admission", "verdict"):  # supervision is not sent in every cycle
        key = f"deltaq-guarded/lab/fr/{name}"
        realm.pump_until(lambda key=key: [where for where, _ in realm.recording].count(key) >= CYCLES)
    return list(realm.recording)


def listening_ports():
    """TCP and UDP ports at which this process listens."""
    mine = set()
    for descriptor in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):
            mine.add(str(descriptor.readlink()))
    ports = set()
    for table, state in (("tcp", "0A"), ("tcp6", "0A"), ("udp", "07"), ("udp6", "07")):
        for row in Path(f"/proc/self/net/{table}").read_text(encoding="ascii").splitlines()[1:]:
            _, local, _, now, *_, inode = row.split()[:10]
            if now == state and f"socket:[{inode}]" in mine:
                ports.add(local)
    return ports


@pytest.mark.long
def test_the_services_move_the_robots_without_an_open_port(tmp_path, lasting_links):
    before = listening_ports()
    realm = LockstepRealm(tmp_path)
    assert listening_ports() == before
    realm.assert_moves(CYCLES, STEP)
    realm.close()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
@pytest.mark.long
def test_another_user_cannot_reach_the_sockets(realm):
    links = list(guarded_links(realm.description).values())
    taken = realm.sim.taken
    # the user could read a key of 2**62 possible ones, were there one: nothing here depends on a secret
    done = ran([sys.executable, "-c", STRANGER, json.dumps([NOBODY, *links])], check=False, cwd="/")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == [NOBODY, []]
    assert realm.sim.taken == taken
    realm.assert_moves(3, STEP)


@pytest.mark.long
def test_replayed_messages_move_nothing_in_their_own_cell(realm, insider):
    recording = recorded_motion(realm)
    fr = realm.robots["fr"]
    for _ in range(3):  # the brake of the last admission
        realm.cycle({})
    before, admissions = fr.q.copy(), fr.core.counters["admissions"]
    insider.repeat(recording)
    while not fr.core.counters["stale_admission"]:
        realm.cycle({})
    realm.pump_until(lambda: realm.sim.counters["stale_messages"])
    assert (fr.q == before).all()
    assert fr.core.counters["admissions"] == admissions
    realm.cycle({"fr": STEP})
    fr.cycle()
    assert fr.core.counters["admissions"] == admissions + 1  # and the realm goes on


@pytest.mark.long
def test_replayed_messages_move_no_robot_after_a_restart_of_its_server(realm, insider):
    recording = recorded_motion(realm)
    fr = realm.restart("fr")
    before = tuple(fr.q.tolist())
    # nobody but the recording speaks to the new process
    while not (fr.core.counters["stale_admission"] and fr.core.counters["stale_supervision"]):
        insider.repeat(recording)
        fr.cycle()
        assert fr.state.phase is Phase.OFFLINE
    # and once the gate does, the robot is held as after every restart
    while fr.state.phase is not Phase.HELD:
        insider.repeat([said for said in recording if said[0].endswith(("admission", "supervision"))][-8:])
        realm.turn()
    assert fr.state.reason is ReasonCode.SERVER_LOST
    assert fr.core.counters["admissions"] == 0
    assert fr.state.q_cmd == before


@pytest.mark.long
def test_replayed_messages_move_nothing_after_a_restart_of_the_gate(realm, insider):
    recording = recorded_motion(realm)
    for _ in range(3):  # the brake of the last admission
        realm.cycle({})
    realm.restart_gate()
    requests = [said for said in recording if said[0].endswith(("request", "command"))]
    q = {name: robot.q.copy() for name, robot in realm.robots.items()}
    while not realm.sim.counters["stale_messages"]:
        insider.repeat(requests)
        realm.pump()
    realm.settle_held()
    for _ in range(3):
        insider.repeat(recording)
        realm.turn()
    assert not [name for name in realm.sim.counters if name.startswith(("admitted", "scaled", "command_"))]
    for name, robot in realm.robots.items():
        assert (robot.q == q[name]).all()


@pytest.mark.long
def test_restarted_processes_finish_their_handshake_within_three_cycles(realm):
    """Counted from the first state that arrives: a link of zenoh takes up to a fifth of a second to come back."""
    fr = realm.restart("fr")
    realm.restart_gate()

    def gate_is_heard():
        return fr.supervision is not None and fr.supervision.epoch == realm.sim.epoch

    while realm.sim.robots["fr"].tracker.state is None:
        realm.turn()
    cycles = 0
    while not gate_is_heard():
        cycles += 1
        fr.cycle()
        end_s = time.monotonic() + 10.0
        while not gate_is_heard() and time.monotonic() < end_s:
            realm.pump()
    assert cycles <= 3
