"""The table of clients' rights is obeyed: on each row a core refuses those of too little a role, and no others."""

import itertools

import pytest
from small_cell import server_state, small_cell, told, tool_pose

from deltaq_protocol import client_rights, topics
from deltaq_protocol.client_rights import RIGHTS, ClientRole, least_role
from deltaq_protocol.messages import (
    ContactRequest,
    DryRunRequest,
    Error,
    IoRequest,
    LeaseAction,
    LeaseReply,
    LeaseRequest,
    ResetRequest,
    StopRequest,
    ViewRequest,
)
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.topic import Party, Realm
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.core import HliCore
from deltaq_services.outputs import ClientOrigin, Sender, ToSender

TOKENS = {ClientRole.OBSERVER: None, ClientRole.CONTROLLER: "controller", ClientRole.OPERATOR: "operator"}
IDENTITIES = {
    ClientRole.OBSERVER: "",
    ClientRole.CONTROLLER: "controller-tower",
    ClientRole.OPERATOR: "operator-desk",
}
REFUSALS = {ReasonCode.NOT_PERMITTED, ReasonCode.LEASE_NOT_HELD}
CONTACTS = {"touch": {"bodies": ["fr/wrist"], "against": ["gr/wrist"]}}


class Asker(Sender):
    def __init__(self, identity=""):
        self.origin = ClientOrigin("asker", identity=identity)

    def deliver(self, message):
        raise AssertionError("the core only hands it back")


def request_of(right, token):
    match right.topic.name, right.what:
        case "lease", action:
            return LeaseRequest(robot="gr", action=action, token=token)
        case "reset", _:
            return ResetRequest(robot="gr", token=token)
        case "contact", _:
            return ContactRequest(contact="touch", allowed=True, token=token)
        case "io", what:
            return IoRequest(robot="gr", outputs={"gripper": True} if what == "set" else {})
        case "dry-run", _:
            return DryRunRequest(robot="gr", dq=(0.0,) * 9)
        case "view", _:
            return ViewRequest(robot="fr", distance_m=1.0, token=token)
        case "stop", _:
            return StopRequest()
    return None


ASKED = [right for right in RIGHTS if request_of(right, None) is not None]


def is_refused(right, token, identity):
    """Whether a core refuses it for want of a right, to who holds no lease."""
    cell, names = small_cell(contacts=CONTACTS), (f"token-{k}" for k in itertools.count())
    roles = ClientRoles("operator", "controller")
    core = HliCore(cell, told(cell), tool_pose, lambda: next(names), 1000, roles)
    core.take(server_state("gr", 100), 50.0)
    outputs = core.take(request_of(right, token), 50.0, Asker(identity))
    answers = [output.message for output in outputs if isinstance(output, ToSender)]
    return any(isinstance(answer, Error | LeaseReply) and answer.code in REFUSALS for answer in answers)


@pytest.mark.parametrize("right", ASKED, ids=lambda right: f"{right.topic.name} {right.what}".strip())
@pytest.mark.parametrize("role", ClientRole)
def test_who_may_is_not_refused_and_who_may_not_is(right, role):
    wanted = right.of_holder or role < right.least
    assert is_refused(right, TOKENS[role], "") == wanted
    assert is_refused(right, None, IDENTITIES[role]) == wanted


def test_every_topic_of_a_client_has_a_row_and_every_row_a_topic_of_clients():
    of_clients = {
        topic.name
        for topic in topics.TOPICS
        if topic.realm is Realm.OPEN and Party.CLIENT in (*topic.publishers, *topic.readers)
    }
    assert {right.topic.name for right in RIGHTS} == of_clients
    leases = {right.what for right in RIGHTS if right.topic is topics.LEASE}
    assert leases == set(LeaseAction)
    assert len({(right.topic.name, right.what) for right in RIGHTS}) == len(RIGHTS)


def test_another_row_changes_what_is_refused(monkeypatch):
    right = next(right for right in RIGHTS if right.topic is topics.RESET)
    assert least_role(topics.RESET) is ClientRole.OPERATOR
    monkeypatch.setitem(client_rights._LEAST, (topics.RESET.name, ""), ClientRole.OBSERVER)
    assert not is_refused(right, None, "")
