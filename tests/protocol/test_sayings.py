"""Who says what to whom in the guarded realm: one speaker under each key, and nobody but the topics' table has."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_protocol import topics
from deltaq_protocol.sayings import HLI, SIM, is_acted_upon, robot_server, sayings, services
from deltaq_protocol.topic import Party, Realm

PARTY = {SIM: Party.SIM, HLI: Party.HLI}
ROBOTS = st.lists(st.from_regex(r"[a-z][a-z0-9_-]{0,9}", fullmatch=True), min_size=1, max_size=5, unique=True)


def party(service):
    return PARTY.get(service, Party.ROBOT_SERVER)


@given(ROBOTS)
def test_each_key_has_one_speaker_and_each_of_its_listeners_reads_that_topic(robots):
    table = sayings("cell", robots)
    assert len({row.key for row in table}) == len(table)
    for row in table:
        assert party(row.speaker) in row.topic.publishers
        assert row.listeners
        assert len(set(row.listeners)) == len(row.listeners)
        assert {row.speaker, *row.listeners} <= set(services(robots))
        for listener in row.listeners:
            assert party(listener) in row.topic.readers
            assert listener != row.speaker


@given(ROBOTS)
def test_topics_of_a_robot_belong_to_its_own_server_alone(robots):
    for row in sayings("cell", robots):
        if "{robot}" in row.topic.template:
            [robot] = [robot for robot in robots if row.key == row.topic.key("cell", robot=robot)]
            servers = {name for name in (row.speaker, *row.listeners) if party(name) is Party.ROBOT_SERVER}
            assert servers <= {robot_server(robot)}


def test_the_access_table_contains_exactly_the_topics_that_services_act_on():
    said = {row.topic.name for row in sayings("cell", ["fr"])}
    assert said == {row.name for row in topics.TOPICS if is_acted_upon(row)}
    for topic in topics.TOPICS:
        believed = set(topic.readers) - {Party.WATCHER}
        assert is_acted_upon(topic) == (topic.realm is Realm.GUARDED and bool(believed))


@pytest.mark.parametrize(
    ("key", "speaker", "listeners"),
    [
        ("fr/state", "robot-server-fr", ("sim", "hli")),
        ("gr/admission", "sim", ("robot-server-gr",)),
        ("command", "hli", ("sim",)),
        ("health/sim", "sim", ("hli",)),
        ("health/robot-server-fr", "robot-server-fr", ("hli", "sim")),
    ],
)
def test_rows_of_the_lab_cell(key, speaker, listeners):
    [row] = [row for row in sayings("lab", ["fr", "gr"]) if row.key == f"deltaq-guarded/lab/{key}"]
    assert (row.speaker, row.listeners) == (speaker, listeners)
