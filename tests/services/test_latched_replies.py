"""What a stop or a reset is answered with, and when: done means that the robots have shown it."""

import itertools
from typing import Any

import pytest
from gate_rig import CELL, Rig
from small_cell import server_state, small_cell, told, tool_pose

from deltaq_protocol.guarded import Command, CommandReply, Health
from deltaq_protocol.messages import Error, Phase, ResetRequest, StopRequest
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.topic import Realm
from deltaq_services.hli.commands import REPLY_DEADLINE_S
from deltaq_services.hli.core import HliCore
from deltaq_services.outputs import Output, Sender, ToSender, published
from deltaq_services.sim.core import Sim


def _replies(rig: Rig) -> list[CommandReply]:
    return [message for message in rig.said if isinstance(message, CommandReply)]


def _cycles_until_answered(rig: Rig) -> int:
    for cycle in range(1, 50):
        rig.cycle()
        if _replies(rig):
            return cycle
    raise AssertionError("never answered")


def test_a_stop_is_answered_once_when_every_robot_shows_its_hold() -> None:
    rig = Rig()
    rig.request()
    rig.cycle()
    assert rig.command(kind="stop") is None
    _cycles_until_answered(rig)
    (reply,) = _replies(rig)
    assert reply.accepted
    assert {server.state.phase for server in rig.servers.values()} == {Phase.HELD}
    for _ in range(5):
        rig.cycle()
        assert not _replies(rig)


def test_waiting_for_confirmation_does_not_delay_a_stop() -> None:
    rig = Rig()
    rig.command(kind="stop")
    rig.cycle()  # the gate's supervision on this state orders it
    assert rig.mail["fr"][1].stop is ReasonCode.OPERATOR_STOP
    rig.cycle()  # and the Robot Server obeys it with the very next telegram
    assert rig.state.phase is Phase.HELD


def test_a_stop_of_held_robots_is_confirmed_at_once() -> None:
    rig = Rig()
    rig.command(kind="stop")
    _cycles_until_answered(rig)
    assert rig.command(kind="stop").accepted
    rig.cycle()
    assert not _replies(rig)


def _about_to_be_reset() -> Rig:
    rig = Rig()
    rig.command(kind="stop")
    _cycles_until_answered(rig)
    for _ in range(10):
        rig.cycle()
    assert rig.command(kind="reset", robot="fr") is None
    return rig


def test_a_hold_about_to_be_reset_does_not_confirm_a_stop() -> None:
    rig = _about_to_be_reset()
    assert rig.command(kind="stop") is None
    _cycles_until_answered(rig)
    rig.cycle()
    assert rig.state.phase is Phase.HELD


@pytest.mark.parametrize("unheard", ["never", "any more"])
def test_a_stop_of_a_silent_robot_is_never_confirmed(unheard: str) -> None:
    rig = Rig()
    if unheard == "never":
        rig.sim = Sim(CELL, epoch=5)
    else:
        rig.request(robot="gr", dq=(1e-5, *(0.0,) * 8))
        rig.cycle()
    del rig.servers["gr"]
    rig.command(kind="stop")
    for _ in range(50):
        rig.cycle()
        assert not _replies(rig)
    assert rig.state.phase is Phase.HELD  # the other one has stopped


def test_a_reset_is_answered_when_the_robot_shows_it() -> None:
    rig = _about_to_be_reset()
    _cycles_until_answered(rig)
    assert rig.state.phase is Phase.READY


# --- the HLI ----------------------------------------------------------------------------------------


class _Client(Sender):
    lasting = True

    def deliver(self, message: Any) -> None:
        raise AssertionError("the core only hands it back")


def _hli(epoch: int = 0) -> HliCore:
    """An HLI that knows fr held, under the gate of an epoch."""
    cell = small_cell()
    tokens = (f"token-{k}" for k in itertools.count())
    core = HliCore(cell, told(cell), tool_pose, lambda: next(tokens), 1000)
    core.on_server_state(server_state("fr", 100, Phase.HELD, epoch=epoch), 50.0)
    return core


def _sent(outputs: list[Output]) -> Command:
    (command,) = (output.message for output in published(outputs, Realm.GUARDED))
    assert isinstance(command, Command)
    return command


def _alive(core: HliCore, epoch: int, newest_id: int) -> None:
    cell = core.description.identity
    core.on_health(
        Health(service="sim", healthy=True, time_s=1.0, cell=cell, epoch=epoch, newest_id=newest_id), 50.0
    )


def _reset(core: HliCore) -> Command:
    return _sent(core.requests.on_reset(ResetRequest(robot="fr"), _Client(), 50.0))


def test_the_first_reset_names_the_present_gate() -> None:
    by_sign_of_life, by_state = _hli(), _hli(epoch=7)
    _alive(by_sign_of_life, epoch=7, newest_id=5000)
    assert (_reset(by_sign_of_life).epoch, _reset(by_state).epoch) == (7, 7)
    assert _reset(by_sign_of_life).id > 5000


def test_after_a_restart_of_the_gate_its_own_epoch_counts() -> None:
    core = _hli(epoch=7)
    _alive(core, epoch=9, newest_id=0)
    core.on_server_state(server_state("fr", 101, Phase.HELD, epoch=7), 50.0)
    assert _reset(core).epoch == 9


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("stop", "stop is not confirmed: the gate did not answer within 0.5 s that every robot is held"),
        ("reset", "reset is not confirmed: the gate did not answer within 0.5 s that fr is reset"),
    ],
)
def test_a_missing_confirmation_of_the_gate_is_reported(kind: str, said: str) -> None:
    core, client = _hli(epoch=7), _Client()
    if kind == "stop":
        asked = core.requests.on_stop(StopRequest(), client, 50.0)
    else:
        asked = core.requests.on_reset(ResetRequest(robot="fr"), client, 50.0)
    assert not any(isinstance(output, ToSender) for output in asked)
    # meanwhile a stop is sent again, and nobody is told anything
    assert not any(isinstance(output, ToSender) for output in core.on_tick(50.0 + REPLY_DEADLINE_S - 0.001))
    answer, *_ = (output for output in core.on_tick(50.0 + REPLY_DEADLINE_S) if isinstance(output, ToSender))
    assert isinstance(answer.message, Error)
    assert (answer.message.code, answer.message.request) == (ReasonCode.UNREACHABLE, kind)
    assert answer.message.message == said
    assert "it was sent, and " in answer.message.hint
    assert core.counters["commands_unanswered"] == 1
    late = CommandReply(id=_sent(asked).id, accepted=True)
    assert core.on_command_reply(late) == []  # one answer, not two
