"""What a camera is asked to look at: what the HLI refuses, keeps and tells."""

from typing import Any

import pytest
from small_cell import server_state, small_cell, told, tool_pose

from deltaq_cell.description import CellDescription
from deltaq_protocol.audit import AuditKind, AuditOutcome
from deltaq_protocol.codec import InvalidMessageError, from_map
from deltaq_protocol.messages import (
    Error,
    LeaseAction,
    LeaseRequest,
    RobotState,
    ViewReply,
    ViewRequest,
    ViewTarget,
    ViewWish,
)
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.commands import Deed
from deltaq_services.hli.core import HliCore
from deltaq_services.outputs import Sender, ToSender


def three_robots() -> CellDescription:
    """The small cell with a camera on fr and on a third robot."""
    description = small_cell().model_dump(mode="json", exclude_unset=True)
    robots = description["robots"]
    robots["fr"]["camera"] = {}
    robots["fr2"] = robots["fr"] | {"server": small_cell().sim}
    return CellDescription.model_validate(description)


class Desk(Sender):
    """Who asks for views, and what it is answered."""

    lasting = True

    def __init__(self, controller_token: str | None = None) -> None:
        self.deeds: list[Deed] = []
        cell = three_robots()
        roles = ClientRoles("operator", controller_token)
        self.core = HliCore(cell, told(cell), tool_pose, lambda: "token", 1000, roles, self.deeds.append)

    def deliver(self, message: object) -> None:
        raise AssertionError("the core only hands it back")

    def ask(self, robot: str = "fr", **fields: Any) -> ViewReply | Error:
        request = from_map(ViewRequest, {"robot": robot, **fields})
        (output,) = self.core.take(request, 50.0, self)
        assert isinstance(output, ToSender)
        assert isinstance(output.message, ViewReply | Error)
        return output.message

    def shown(self, robot: str = "fr") -> ViewWish | None:
        """What the robot's next state says."""
        states = [o.message for o in self.core.take(server_state(robot, 100), 50.0)]
        (state,) = [message for message in states if isinstance(message, RobotState)]
        return state.view


@pytest.mark.parametrize(
    ("robot", "fields", "code", "said"),
    [
        ("ghost", {}, ReasonCode.UNKNOWN_ROBOT, "no robot ghost"),
        ("gr", {"distance_m": 1.0}, ReasonCode.MALFORMED, "robot: gr carries no camera; fr, fr2 does"),
        (
            "fr",
            {"leader": "ghost"},
            ReasonCode.MALFORMED,
            "'ghost' is not another robot; fr can look at gr, fr2",
        ),
        ("fr", {"leader": "fr"}, ReasonCode.MALFORMED, "'fr' is not another robot"),
        (
            "fr",
            {"leader": "gr", "focus_m": (0, 0, 1)},
            ReasonCode.MALFORMED,
            "focus_m: a fixed point of the world",
        ),
        (
            "fr",
            {"targets": [{"leader": "gr"}], "leader": "fr2"},
            ReasonCode.MALFORMED,
            "targets: given together with leader,",
        ),
        (
            "fr",
            {"targets": [{"leader": "gr"}, {"leader": "fr"}]},
            ReasonCode.MALFORMED,
            "targets.1.leader: 'fr' is not another robot; there are gr, fr2",
        ),
        (
            "fr",
            {"targets": [{"leader": "gr"}, {"leader": "fr2", "focus_m": (0, 0, 1)}]},
            ReasonCode.MALFORMED,
            "targets.1.focus_m: a fixed point of the world",
        ),
        (
            "fr",
            {"targets": [{"aim_offset_m": (0, 0, 1)}]},
            ReasonCode.MALFORMED,
            "targets.0.leader: missing, and so is focus_m",
        ),
    ],
)
def test_an_impossible_view_is_refused_and_changes_nothing(
    robot: str, fields: dict[str, Any], code: ReasonCode, said: str
) -> None:
    desk = Desk()
    answer = desk.ask(robot, **fields)
    assert isinstance(answer, Error)
    assert answer.code is code
    assert said in answer.message
    assert desk.shown() is None
    assert (desk.deeds[-1].what, desk.deeds[-1].outcome) == (AuditKind.VIEW, AuditOutcome.REFUSED)


@pytest.mark.parametrize(
    "fields",
    [
        {"distance_m": 0.1},
        {"distance_m": 9.0},
        {"distance_m": float("nan")},
        {"focus_m": (0.0, 1.0)},
        {"targets": []},
        {"targets": [{"leader": "gr"}] * 9},
        {"targets": [{"leader": "gr", "weight": 2}]},
        {"targets": [{"focus_m": (0.0, 0.0, 1e9)}]},
    ],
)
def test_a_view_beyond_its_bounds_is_malformed(fields: dict[str, Any]) -> None:
    with pytest.raises(InvalidMessageError, match=next(iter(fields))):
        Desk().ask(**fields)


def test_a_view_needs_the_controller_token_if_configured() -> None:
    desk = Desk(controller_token="open sesame")
    answer = desk.ask(distance_m=1.0)
    assert isinstance(answer, Error)
    assert answer.code is ReasonCode.NOT_PERMITTED
    assert isinstance(desk.ask(distance_m=1.0, token="open sesame"), ViewReply)


def test_view_requests_accumulate_and_are_published_in_states() -> None:
    desk = Desk()
    assert desk.shown() is None
    desk.ask(distance_m=0.9)
    answer = desk.ask(aim_offset_m=(0.0, 0.0, 0.04))
    assert answer == ViewReply(robot="fr", view=ViewWish(distance_m=0.9, aim_offset_m=(0.0, 0.0, 0.04)))
    assert desk.shown() == answer.view
    assert desk.shown("fr2") is None
    assert (desk.deeds[-1].what, desk.deeds[-1].outcome) == (AuditKind.VIEW, AuditOutcome.DONE)


def test_a_request_for_a_tool_ends_a_fixed_point() -> None:
    desk = Desk()
    desk.ask(focus_m=(0.0, -1.0, 1.0), distance_m=1.0)
    assert desk.shown() == ViewWish(distance_m=1.0, focus_m=(0.0, -1.0, 1.0))
    desk.ask(distance_m=1.1)
    assert desk.shown() == ViewWish(distance_m=1.1, focus_m=(0.0, -1.0, 1.0)), "it does not end by itself"
    desk.ask(leader="fr2")
    assert desk.shown() == ViewWish(distance_m=1.1, leader="fr2")


def test_several_targets_replace_a_single_one_and_end_with_the_next_kind() -> None:
    desk = Desk()
    desk.ask(leader="fr2", aim_offset_m=(0.0, 0.0, 0.04), distance_m=1.0)
    targets = (ViewTarget(leader="gr"), ViewTarget(focus_m=(0.0, -1.0, 1.0)))
    answer = desk.ask(targets=[target.model_dump() for target in targets])
    assert answer == ViewReply(robot="fr", view=ViewWish(distance_m=1.0, targets=targets))
    desk.ask(distance_m=1.1)
    assert desk.shown() == ViewWish(distance_m=1.1, targets=targets), "they do not end by themselves"
    for fields in ({"leader": "gr"}, {"aim_offset_m": (0.0, 0.0, 0.1)}, {"focus_m": (0.0, 0.0, 1.0)}):
        desk.ask(targets=[target.model_dump() for target in targets])
        desk.ask(**fields)
        assert desk.shown() == ViewWish(distance_m=1.1, **fields)


def test_a_requested_view_outlives_the_followers_lease() -> None:
    desk = Desk()
    desk.core.take(server_state("fr", 100), 50.0)
    request = LeaseRequest(robot="fr", action=LeaseAction.ACQUIRE, client="follower")
    desk.core.take(request, 50.0, desk)
    answer = desk.ask(distance_m=1.0)
    assert isinstance(answer, ViewReply)
    assert answer.holder == "follower"
    release = LeaseRequest(robot="fr", action=LeaseAction.RELEASE, lease="token")
    desk.core.take(release, 50.0, desk)
    answer = desk.ask()
    assert answer == ViewReply(robot="fr", view=ViewWish(distance_m=1.0), holder=None)
    assert desk.shown() == ViewWish(distance_m=1.0)
