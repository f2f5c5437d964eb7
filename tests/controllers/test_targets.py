"""Which of several targets a camera looks at, whatever hides them and however often."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_controllers.camera.in_use import HIDDEN_S, VISIBLE_S, TargetChoice, targets_of
from deltaq_protocol.messages import ViewTarget, ViewWish

STEP_S = 0.125


def chosen_over(choice: TargetChoice, visible: list[tuple[bool, ...]], begin_s: float = 0.0) -> list[int]:
    """The choice after each time at which all targets were looked for."""
    chosen = []
    for step, all_visible in enumerate(visible):
        for place, is_visible in enumerate(all_visible):
            choice.saw(place, is_visible, begin_s + step * STEP_S)
        chosen.append(choice.chosen)
    return chosen


def test_the_first_target_is_kept_until_it_was_hidden_for_a_while() -> None:
    chosen = chosen_over(TargetChoice(2), [(True, True)] * 16 + [(False, True)] * 20)
    assert chosen.index(1) * STEP_S == 2.0 + HIDDEN_S
    assert set(chosen[chosen.index(1) :]) == {1}


def test_a_target_is_chosen_only_after_it_was_visible_for_a_while() -> None:
    chosen = chosen_over(TargetChoice(2), [(False, True)] * 20)
    assert chosen.index(1) * STEP_S == VISIBLE_S


def test_the_choice_stays_while_all_targets_are_hidden() -> None:
    choice = TargetChoice(3)
    assert set(chosen_over(choice, [(False,) * 3] * 30)) == {0}
    assert choice.is_hidden
    assert chosen_over(choice, [(False, False, True)] * 20, 3.0)[-1] == 2
    assert set(chosen_over(choice, [(False,) * 3] * 30, 5.0)) == {2}


def test_a_restarted_clock_delays_no_caller() -> None:
    choice = TargetChoice(2)
    chosen_over(choice, [(True, True)] * 20, 1e6)
    assert chosen_over(choice, [(False, True)] * 20)[-1] == 1


@given(st.lists(st.tuples(st.booleans(), st.booleans(), st.booleans()), max_size=120))
def test_a_target_is_resumed_only_after_being_visible_for_a_while(
    visible: list[tuple[bool, bool, bool]],
) -> None:
    chosen = chosen_over(TargetChoice(3), visible)
    steps = round(VISIBLE_S / STEP_S)
    for step in range(1, len(chosen)):
        now, before = chosen[step], chosen[step - 1]
        if now == before:
            continue
        lately = visible[max(step - steps, 0) : step + 1]
        assert len(lately) == steps + 1
        assert all(seen[now] for seen in lately)
        if now > before:
            assert not all(seen[before] for seen in lately)


def test_a_target_visible_after_a_return_is_resumed_as_quickly_as_at_first() -> None:
    choice = TargetChoice(2)
    for begin_s in (0.0, 100.0, 200.0):
        hidden = chosen_over(choice, [(False, True)] * 16, begin_s)
        assert hidden[-1] == 1
        seen = chosen_over(choice, [(True, True)] * 160, begin_s + 2.0)
        assert seen.index(0) * STEP_S == VISIBLE_S


STARTED = ViewTarget(leader="gr", aim_offset_m=(0.0, 0.0, 0.04))
POINT = (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("wish", "targets"),
    [
        (ViewWish(), (STARTED,)),
        (ViewWish(distance_m=1.0), (STARTED,)),
        (ViewWish(leader="aide"), (ViewTarget(leader="aide", aim_offset_m=(0.0, 0.0, 0.04)),)),
        (ViewWish(aim_offset_m=POINT), (ViewTarget(leader="gr", aim_offset_m=POINT),)),
        (ViewWish(focus_m=POINT), (ViewTarget(focus_m=POINT),)),
        (ViewWish(targets=(ViewTarget(leader="aide"), STARTED)), (ViewTarget(leader="aide"), STARTED)),
    ],
)
def test_omitted_values_of_a_view_are_those_at_the_followers_start(
    wish: ViewWish, targets: tuple[ViewTarget, ...]
) -> None:
    assert targets_of(wish, STARTED, "gr") == targets


def test_an_offset_after_a_fixed_point_refers_to_the_tool_of_the_leader() -> None:
    started = ViewTarget(focus_m=POINT)
    asked = targets_of(ViewWish(aim_offset_m=POINT), started, "gr")
    assert asked == (ViewTarget(leader="gr", aim_offset_m=POINT),)
