"""The table of topics is obeyed: change a row, and what is done changes with it."""

import contextlib
import itertools
import queue
from collections import Counter
from typing import Any

import msgpack
import pytest
import zenoh
from gate_rig import Rig
from small_cell import endpoint, server_state, small_cell, told, tool_pose
from table import change_row

from deltaq_deploy.command.streams import open_stream
from deltaq_protocol import topics
from deltaq_protocol.access import access
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.guarded import Health
from deltaq_protocol.messages import (
    Increment,
    LeaseAction,
    LeaseReply,
    LeaseRequest,
    NearestPair,
    Phase,
    Verdict,
)
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.session import open_session
from deltaq_protocol.topic import Hertz, Party, Priority, Realm
from deltaq_services.guarded_realm import open_watching_session
from deltaq_services.hli.core import HliCore
from deltaq_services.outputs import Sender, published
from deltaq_services.rate_limit import Pace
from deltaq_services.robot_server.guarded_link import GuardedLink
from reference_pages import page

NOW_S = 50.0


class _Client(Sender):
    lasting = True

    def deliver(self, message: Any) -> None:
        raise AssertionError("the core only hands it back")


def _hli(cycle_s: float, at_cycle: int = 100) -> tuple[HliCore, str]:
    """An HLI that knows fr at a cycle, and its lease."""
    cell = small_cell(cycle_s=cycle_s)
    tokens = (f"token-{k}" for k in itertools.count())
    core = HliCore(cell, told(cell), tool_pose, lambda: next(tokens), 1000)
    core.on_server_state(server_state("fr", at_cycle), NOW_S)
    asked = LeaseRequest(robot="fr", action=LeaseAction.ACQUIRE)
    (reply,) = (o.message for o in core.requests.on_lease(asked, _Client(), NOW_S))
    assert isinstance(reply, LeaseReply)
    return core, str(reply.lease)


def _asked(core: HliCore, lease: str, age: int) -> ReasonCode | None:
    """Why an increment that answers a state so many cycles old is refused; None: it goes to the gate."""
    increment = Increment(robot="fr", seq=1, cycle=100 - age, dq=(0.0,) * 6, lease=lease)
    outputs = core.increments.on_increment(increment, None, NOW_S)
    if published(outputs, Realm.GUARDED):
        return None
    verdict = outputs[0].message
    assert isinstance(verdict, Verdict)
    return verdict.reasons[0].code


def test_at_4_ms_too_an_increment_is_no_older_than_the_table_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _asked(*_hli(0.004), age=25) is ReasonCode.STALE_CYCLE
    assert _asked(*_hli(0.004), age=11) is ReasonCode.STALE_CYCLE
    assert _asked(*_hli(0.004), age=10) is None
    change_row(monkeypatch, "INCREMENT", max_age_cycles=3)
    assert _asked(*_hli(0.004), age=4) is ReasonCode.STALE_CYCLE
    assert _asked(*_hli(0.004), age=3) is None
    change_row(monkeypatch, "INCREMENT", max_age_cycles=100)
    assert _asked(*_hli(0.004), age=31) is ReasonCode.STALE_CYCLE  # the cell's max_request_age_s
    assert _asked(*_hli(0.004), age=30) is None


def _gate_said(age: int) -> tuple[ReasonCode, ...]:
    rig = Rig()
    verdict = rig.request(cycle=rig.state.cycle - age)
    return tuple(reason.code for reason in verdict.reasons if reason.code is ReasonCode.STALE_CYCLE)


def test_the_gate_takes_no_request_that_is_older_than_the_table_allows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert _gate_said(age=9) == ()
    change_row(monkeypatch, "REQUEST", max_age_cycles=8)
    assert _gate_said(age=9) == (ReasonCode.STALE_CYCLE,)
    assert _gate_said(age=8) == ()


def _gate_took_io(age: int) -> ReasonCode | None:
    rig = Rig()
    cycles = {name: state.cycle - age for name, server in rig.servers.items() if (state := server.state)}
    code: ReasonCode | None = rig.command(kind="io", robot="gr", outputs={}, cycles=cycles).code
    return code


@pytest.mark.long
def test_the_gate_takes_no_command_that_is_older_than_the_table_allows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert _gate_took_io(age=5) is None
    change_row(monkeypatch, "COMMAND", max_age_cycles=4)
    assert _gate_took_io(age=5) is ReasonCode.STALE_CYCLE
    assert _gate_took_io(age=4) is None


def _phase_after(silence_s: float) -> Phase:
    core, _ = _hli(0.012)
    return core.status(NOW_S + silence_s, Counter()).robots["fr"].phase


def test_a_robot_whose_state_is_older_than_the_table_allows_is_offline(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert (_phase_after(0.119), _phase_after(0.121)) == (Phase.READY, Phase.OFFLINE)
    change_row(monkeypatch, "SERVER_STATE", max_age_cycles=3)
    assert (_phase_after(0.035), _phase_after(0.037)) == (Phase.READY, Phase.OFFLINE)


def _admissions_taken(late_cycles: int) -> int:
    """Admissions that FR's Robot Server takes which come so many cycles late, the robot at rest."""
    rig = Rig()
    rig.request()
    admission, supervision = rig.mail["fr"]
    server = rig.servers["fr"]
    for _ in range(late_cycles):
        rig.mail["fr"] = (None, supervision)
        rig.cycle()
    assert admission is not None
    now = server.state
    # at rest nothing but its cycle tells that it is late
    rig.mail["fr"] = (admission.model_copy(update={"follows_q_cmd": now.q_cmd}), supervision)
    rig.cycle()
    return server.counters["admissions"]


@pytest.mark.long
def test_a_robot_server_takes_no_admission_that_is_older_than_the_table_allows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert (_admissions_taken(0), _admissions_taken(1)) == (1, 0)
    change_row(monkeypatch, "ADMISSION", max_age_cycles=1)
    assert (_admissions_taken(1), _admissions_taken(2)) == (1, 0)


# --- pace and health --------------------------------------------------------------------------------


@pytest.mark.parametrize("step_s", [0.004, 0.012, 0.02, 0.1])
def test_a_pace_is_kept_on_average_at_any_rate_of_polling(step_s: float) -> None:
    pace = Pace(0.1)
    assert sum(pace.due(k * step_s) for k in range(round(10.0 / step_s))) == pytest.approx(100, abs=1)


def test_after_a_pause_no_messages_are_made_up() -> None:
    pace = Pace(0.1)
    assert pace.due(0.0)
    assert [pace.due(60.0 + k * 0.01) for k in range(5)] == [True, False, False, False, False]


def _cycle(number: int) -> bytes:
    """A state's cycle, as it is packed."""
    return bytes(msgpack.packb("cycle") + msgpack.packb(number))


def _published_until_heard(link: GuardedLink, states: queue.SimpleQueue[Any], cycle: int, at_s: float) -> Any:
    """The sample of a state; published again where a connection that stood still has dropped it."""
    while True:
        link.publish(server_state("fr", cycle), at_s)
        with contextlib.suppress(queue.Empty):
            while _cycle(cycle) not in (state := states.get(timeout=2.0)).payload.to_bytes():
                pass
            return state


class _Listened:
    """What a listener hears over zenoh of a Robot Server's link in ten seconds of that server's clock."""

    def __init__(self) -> None:
        cell = small_cell()
        link = GuardedLink(cell, "fr", Counter())
        listener = open_watching_session(cell, "robot-server-fr")
        heard: queue.SimpleQueue[Any] = queue.SimpleQueue()
        states: queue.SimpleQueue[Any] = queue.SimpleQueue()
        listener.declare_subscriber(topics.HEALTH.key("small"), heard.put)
        listener.declare_subscriber(topics.SERVER_STATE.key("small"), states.put)
        try:
            while states.empty():  # until the listener is known
                link.publish(server_state("fr"), 0.0)
            for cycle in range(500):
                # the listener keeps step: of what comes faster than it is taken, some would be dropped
                state = _published_until_heard(link, states, 1000 + cycle, 1000.0 + cycle * 0.02)
            link.publish(None, 1011.0, lambda: "end")  # a marker: a heartbeat that is out of turn
            samples = [state]
            while b"end" not in samples[-1].payload.to_bytes():
                samples.append(heard.get(timeout=300.0))
        finally:
            listener.close()
            link.close()
        self.signs_of_life = sum(str(sample.key_expr).startswith(_HEALTH_KEY) for sample in samples) - 1
        self.urgency = {
            str(sample.key_expr).rpartition("/")[2]: (sample.express, sample.priority) for sample in samples
        }


_HEALTH_KEY = topics.HEALTH.key("small", service="")


def test_heartbeats_have_the_rate_and_priority_of_the_table(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    listened = _Listened()
    assert listened.signs_of_life == pytest.approx(100, abs=2)
    assert listened.urgency["robot-server-fr"] == (False, zenoh.Priority.DATA)
    assert listened.urgency["state"] == (True, zenoh.Priority.REAL_TIME)
    change_row(monkeypatch, "HEALTH", rate=Hertz(2.0), priority=Priority.URGENT)
    listened = _Listened()
    assert listened.signs_of_life == pytest.approx(20, abs=2)
    assert listened.urgency["robot-server-fr"] == (True, zenoh.Priority.REAL_TIME)


def _pairs_published(core: HliCore) -> int:
    pair = NearestPair(pair=("a", "b"), distance_m=0.4, points_m=((0, 0, 0), (0, 0, 0.4)))
    outputs = []
    for k in range(100):
        at_s = NOW_S + k * 0.1
        health = Health(
            service="sim", healthy=True, time_s=at_s, nearest=pair, cell=core.description.identity
        )
        outputs += core.on_health(health, at_s)
    return len(published(outputs, Realm.OPEN))


def test_the_nearest_pair_has_the_rate_of_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _pairs_published(_hli(0.012)[0]) == 100
    change_row(monkeypatch, "PROXIMITY", rate=Hertz(5.0))
    assert _pairs_published(_hli(0.012)[0]) == 50


def _lagging_at(period_s: float) -> tuple[str, ...]:
    core, _ = _hli(0.012)
    for k in range(200):
        core.on_server_state(server_state("fr", 101 + k), NOW_S + k * period_s)
    return core.lagging(NOW_S + 199 * period_s)


def test_a_stream_slower_than_the_table_lags(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not [said for said in _lagging_at(0.012) if said.startswith("fr:")]
    assert "fr: server-state at 50.0 Hz, expected 83.3 Hz" in _lagging_at(0.02)
    change_row(monkeypatch, "SERVER_STATE", rate=Hertz(40.0))
    assert not [said for said in _lagging_at(0.02) if said.startswith("fr:")]


# --- who says what, and who hears it ----------------------------------------------------------------


def _client(where: str) -> Any:
    """A client in zenoh's sense: what two of them say to one another a peer between them would hand on."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{where}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def _overheard_of_another_client() -> tuple[set[str], set[bytes]]:
    """Keys that a client hears of what another publishes, and the answers that one gets to a stop."""
    where, keys = endpoint(), topics.STATE.key("lab", robot="end")
    server = open_session(listen=[where], access=access(Party.HLI, Realm.OPEN, "lab"))
    speaker, listener = _client(where), _client(where)
    served: queue.SimpleQueue[str] = queue.SimpleQueue()
    heard: queue.SimpleQueue[str] = queue.SimpleQueue()
    try:
        server.declare_subscriber("deltaq/**", lambda sample: served.put(str(sample.key_expr)))
        server.declare_queryable("deltaq/lab/stop", lambda q: q.reply("deltaq/lab/stop", b"HLI"))
        listener.declare_queryable("deltaq/lab/stop", lambda q: q.reply("deltaq/lab/stop", b"forged"))
        listener.declare_subscriber("deltaq/**", lambda sample: heard.put(str(sample.key_expr)))
        while heard.empty():  # until it is known who listens
            server.put(keys, b"")
        while served.empty():
            speaker.put(topics.INCREMENT.key("lab", robot="gr"), b"")
        for topic in (topics.STATE, topics.VERDICT, topics.INCREMENT):
            speaker.put(topic.key("lab", robot="fr"), b"the lease, or a lie")
        while served.get(timeout=300.0) != topics.INCREMENT.key("lab", robot="fr"):
            pass
        replies = speaker.get("deltaq/lab/stop", target=zenoh.QueryTarget.ALL, timeout=300.0)
        answers = {reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None}
        server.put(topics.VERDICT.key("lab", robot="end"), b"")
        overheard = set()
        while (key := heard.get(timeout=300.0)) != topics.VERDICT.key("lab", robot="end"):
            overheard.add(key)
        return overheard - {keys}, answers
    finally:
        for session in (listener, speaker, server):
            session.close()


def test_no_client_reads_messages_of_another_or_publishes_for_the_server(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert _overheard_of_another_client() == (set(), {b"HLI"})
    change_row(monkeypatch, "INCREMENT", publishers=(Party.CLIENT, Party.HLI))
    overheard, _ = _overheard_of_another_client()
    assert topics.INCREMENT.key("lab", robot="fr") in overheard


def test_clients_cannot_watch_topics_without_the_right_to_read(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(
        DeltaqError, match=r"'increment' is read by the HLI alone; .* are state, verdict, prox"
    ):
        open_stream("increment")
    change_row(monkeypatch, "INCREMENT", readers=(Party.HLI, Party.CLIENT))
    assert open_stream("increment") is topics.INCREMENT


def test_the_reference_agrees_with_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    before = page("reference/topics.md")
    change_row(monkeypatch, "PROXIMITY", rate=Hertz(7.0), recorded=False)
    (changed,) = set(page("reference/topics.md").splitlines()) - set(before.splitlines())
    assert "`proximity`" in changed
    assert "| 7 Hz |" in changed
