"""The table of topics: every key is its own, and no wildcard of one realm reaches into the other."""

import itertools
from dataclasses import replace

import pytest
import zenoh

from deltaq_protocol.messages import Message
from deltaq_protocol.topic import Kind, Party, Realm, Topic
from deltaq_protocol.topics import (
    ADMISSION,
    COMMAND,
    DESCRIPTION,
    HEALTH,
    INCREMENT,
    PROXIMITY,
    REQUEST,
    SERVER_STATE,
    STATE,
    TOPICS,
    VERDICT,
)


def test_names_are_unique() -> None:
    assert len({topic.name for topic in TOPICS}) == len(TOPICS)


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_every_filled_in_key_is_a_valid_zenoh_key(topic: Topic) -> None:
    key = topic.key("lab", robot="fr", service="sim")
    assert "{" not in key
    assert "*" not in key
    assert str(zenoh.KeyExpr(key)) == key
    assert zenoh.KeyExpr(topic.key("lab")).includes(zenoh.KeyExpr(key))


def test_an_omitted_field_is_a_wildcard() -> None:
    assert INCREMENT.key("lab") == "deltaq/lab/*/increment"
    assert STATE.key("lab", robot="fr") == "deltaq/lab/fr/state"
    assert DESCRIPTION.key("*") == "deltaq/*/description"


def test_no_message_of_one_topic_reaches_the_subscribers_of_another() -> None:
    for one, other in itertools.permutations(TOPICS, 2):
        key = zenoh.KeyExpr(one.key("lab", robot="fr", service="sim"))
        assert not zenoh.KeyExpr(other.key("*")).intersects(key), (one.name, other.name)


def test_no_subscription_in_the_open_realm_matches_a_guarded_topic() -> None:
    everything_open = zenoh.KeyExpr("deltaq/**")
    for topic in TOPICS:
        is_open = everything_open.intersects(zenoh.KeyExpr(topic.key("*")))
        assert is_open == (topic.realm is Realm.OPEN), topic.name


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_a_query_has_a_reply_a_stream_has_none_and_both_carry_messages(topic: Topic) -> None:
    assert issubclass(topic.message, Message)
    assert (topic.reply is not None) == (topic.kind is Kind.QUERY)


def test_every_message_that_moves_a_robot_has_a_greatest_age() -> None:
    assert all(topic.age_s(0.012) >= 0.0 for topic in (INCREMENT, REQUEST, SERVER_STATE, ADMISSION, COMMAND))


def test_of_two_greatest_ages_the_lesser_applies() -> None:
    assert INCREMENT.max_age_cycles == 10
    assert INCREMENT.age_cycles(0.004, bound_s=0.12) == 10  # not the 30 that 0.12 s would allow
    assert INCREMENT.age_cycles(0.012, bound_s=0.12) == 10
    assert INCREMENT.age_cycles(0.012, bound_s=0.06) == 5
    assert replace(INCREMENT, max_age_s=0.03).age_cycles(0.012, bound_s=0.06) == 2
    with pytest.raises(ValueError, match="verdict has no greatest age"):
        VERDICT.age_s(0.012)


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_every_topic_has_a_publisher_and_a_reader(topic: Topic) -> None:
    assert topic.publishers
    assert topic.readers
    clients = {*topic.publishers, *topic.readers} & {Party.CLIENT}
    assert bool(clients) == (topic.realm is Realm.OPEN)


def test_the_hlis_heartbeat_comes_no_faster_than_its_rate() -> None:
    assert PROXIMITY.period_s(0.012) >= HEALTH.period_s(0.012)
