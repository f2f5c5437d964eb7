"""Snapshots of the HLI: from each another goes on as the one that it was taken of, whatever comes."""

import random

import pytest
from remembered import remembered
from small_cell import server_state, small_cell, told, tool_pose
from test_hli_core import Client

from deltaq_protocol.codec import InvalidMessageError
from deltaq_protocol.guarded import Admission, Command, CommandReply, Health
from deltaq_protocol.messages import (
    DryRunRequest,
    Hello,
    Increment,
    IoRequest,
    LeaseAction,
    LeaseRequest,
    Outcome,
    Phase,
    Reason,
    ResetRequest,
    StopRequest,
    Verdict,
    ViewRequest,
)
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.topic import Realm
from deltaq_services.hli.core import HliCore
from deltaq_services.outputs import published

ROBOTS = {"fr": 6, "gr": 9}


class Day:
    """What services and clients of a cell may send, at random."""

    def __init__(self, seed):
        self.random = random.Random(seed)
        self.cell = small_cell()
        self.now_s, self.cycle, self.seq = 50.0, 100, 0
        self.clients = [Client(), Client()]
        self.core = self.new_core()
        self.commands = []
        self.seen = set()

    def new_core(self):
        return HliCore(self.cell, told(self.cell), tool_pose, lambda: f"token-{self.now_s}", 1000)

    def token(self, robot):
        lease = self.core.leases.of(robot)
        return None if lease is None else lease.token

    def message(self):
        draw, kinds = self.random, self.kinds()
        robot = draw.choice([*ROBOTS])
        self.seq += draw.choice([0, 1, 1, 1])
        (what,) = draw.choices([*kinds], [weight for weight, _ in kinds.values()])
        self.seen.add(what)
        return kinds[what][1](robot)

    def kinds(self):
        """How often each kind of message comes, and what makes it for a robot."""
        return {
            "state": (9, self.state),
            "increment": (9, self.increment),
            "bad increment": (1, lambda _: InvalidMessageError("dq", ReasonCode.MALFORMED)),
            "verdict": (5, self.verdict),
            "reply": (4, self.reply),
            "health": (1, self.health),
            "lease": (4, self.lease),
            "stop": (1, lambda _: StopRequest()),
            "reset": (1, lambda robot: ResetRequest(robot=robot)),
            "io": (1, lambda robot: IoRequest(robot=robot)),
            "view": (1, lambda robot: ViewRequest(robot=robot, distance_m=self.random.choice([1.0, 2.0]))),
            "dry run": (1, lambda robot: DryRunRequest(robot=robot, dq=(0.0,) * ROBOTS[robot])),
        }

    def state(self, robot):
        self.cycle += 1
        phase = self.random.choices([Phase.READY, Phase.ENGAGED, Phase.HELD], [4, 4, 1])[0]
        return server_state(robot, self.cycle, phase, epoch=self.random.choice([0, 7, 8]))

    def increment(self, robot):
        dq = (0.001,) * ROBOTS[robot]
        lease = self.random.choice([self.token(robot), self.token(robot), None])
        cycle = self.cycle - self.random.choice([0, 0, 1, 5])
        return Increment(robot=robot, seq=self.seq, cycle=cycle, dq=dq, lease=lease)

    def verdict(self, robot):
        bound = self.random.choice([1.0, 1e6])
        reasons = (Reason(code=ReasonCode.LEASE_NOT_HELD, bound=bound),) if self.random.random() < 0.1 else ()
        seq = max(0, self.seq - self.random.randrange(3))
        return Verdict(robot=robot, seq=seq, cycle=self.cycle, outcome=Outcome.REFUSED, reasons=reasons)

    def reply(self, _):
        id_ = self.random.choice(self.commands).id if self.commands else 1
        told_ = {"epoch": 7, "newest_id": id_} if self.random.random() < 0.3 else {}
        code = self.random.choice([None, ReasonCode.REPLAYED_SEQUENCE, ReasonCode.CAUSE_STANDS])
        return CommandReply(id=id_, accepted=code is None, code=code, **told_)

    def health(self, _):
        cell = self.random.choice([told(self.cell).identity] * 4 + ["other-0123456789abcdef"])
        return Health(
            service="sim",
            healthy=True,
            time_s=self.now_s,
            cell=cell,
            epoch=7,
            newest_id=self.random.choice([0, 5000]),
        )

    def lease(self, robot):
        action = self.random.choice([*LeaseAction])
        playout = self.random.random() < 0.5
        return LeaseRequest(robot=robot, action=action, client="x", lease=self.token(robot), playout=playout)


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_a_restored_snapshot_behaves_identically_at_any_moment(seed):
    day = Day(seed)
    for _ in range(700):
        day.now_s += day.random.choice([0.0, 0.004, 0.012, 0.012, 0.3])
        message, sender = day.message(), day.random.choice(day.clients)
        memory = day.core.snapshot()
        before = remembered(memory)
        heir = day.new_core()
        heir.restore(memory)
        outputs = day.core.take(message, day.now_s, sender)
        assert heir.take(message, day.now_s, sender) == outputs
        assert heir.on_tick(day.now_s) == day.core.on_tick(day.now_s)
        assert remembered(heir) == remembered(day.core)
        assert heir.lagging(day.now_s) == day.core.lagging(day.now_s)
        again = day.new_core()
        again.restore(memory)
        assert remembered(again) == remembered(memory) == before  # what came since has changed nothing of it
        day.commands += [
            o.message for o in published(outputs, Realm.GUARDED) if isinstance(o.message, Command)
        ]
    assert len(day.seen) == 12
    counters = day.core.counters
    assert all(
        counters[name] for name in ("requests", "leases_granted", "leases_expired", "stops", "malformed")
    )


def test_messages_of_the_wrong_direction_are_refused_by_type():
    core, client = Day(0).core, Client()
    with pytest.raises(TypeError, match="a StopRequest needs an answer, but has no sender"):
        core.take(StopRequest(), 1.0)
    admission = Admission(
        robot="fr", epoch=1, sequence=1, cycle=1, follows_sequence=0, follows_q_cmd=(0.0,) * 6,
        follows_dq=(0.0,) * 6, dq=(0.0,) * 6, brake_cycles=1,
    )  # fmt: skip
    with pytest.raises(TypeError, match="takes states, verdicts, replies and requests, got a Admission"):
        core.take(admission, 1.0, client)
    (welcome,) = core.take(Hello(protocol=2, client="x"), 1.0, client)
    assert welcome.sender is client
