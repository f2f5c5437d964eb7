"""The table of clients' rights is obeyed: on each row a core refuses those of too little a role, and no others."""

import itertools

import pytest
from small_cell import server_state, small_cell, told, tool_pose
from table import change_row

from deltaq_protocol import topics
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
from deltaq_protocol.topic import ClientRole, Party, Realm, Right
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


def request_of(topic, what, token):
    match topic.name, what:
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


ASKED = [
    (topic, right)
    for topic in topics.TOPICS
    for right in topic.rights
    if request_of(topic, right.what, None) is not None
]


def is_refused(topic, what, token, identity):
    """Whether a core refuses it for want of a right, to who holds no lease."""
    cell, names = small_cell(contacts=CONTACTS), (f"token-{k}" for k in itertools.count())
    roles = ClientRoles("operator", "controller")
    core = HliCore(cell, told(cell), tool_pose, lambda: next(names), 1000, roles)
    core.take(server_state("gr", 100), 50.0)
    outputs = core.take(request_of(topic, what, token), 50.0, Asker(identity))
    answers = [output.message for output in outputs if isinstance(output, ToSender)]
    return any(isinstance(answer, Error | LeaseReply) and answer.code in REFUSALS for answer in answers)


@pytest.mark.parametrize(
    ("topic", "right"), ASKED, ids=[f"{topic.name} {right.what}".strip() for topic, right in ASKED]
)
@pytest.mark.parametrize("role", ClientRole)
def test_permitted_clients_are_accepted_and_others_refused(topic, right, role):
    wanted = right.of_holder or role < right.least
    assert is_refused(topic, right.what, TOKENS[role], "") == wanted
    assert is_refused(topic, right.what, None, IDENTITIES[role]) == wanted


def test_each_client_topic_and_action_has_its_rights_once():
    for topic in topics.TOPICS:
        of_clients = topic.realm is Realm.OPEN and Party.CLIENT in (*topic.publishers, *topic.readers)
        assert bool(topic.rights) == of_clients
        assert len({right.what for right in topic.rights}) == len(topic.rights)
    assert {right.what for right in topics.LEASE.rights} == set(LeaseAction)


def test_a_changed_row_changes_the_refusals(monkeypatch):
    assert topics.RESET.least_role() is ClientRole.OPERATOR
    change_row(monkeypatch, "RESET", rights=(Right(least=ClientRole.OBSERVER),))
    assert not is_refused(topics.RESET, "", None, "")
