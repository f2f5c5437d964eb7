"""The layout for Foxglove: every field that it shows is in a recording, of a kind that its panel can show.

Foxglove itself is not run here.
"""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor import FieldDescriptor
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from deltaq_protocol import topics
from deltaq_protocol.messages import NearestPair, Proximity
from deltaq_testing.recorded import RecordedCell, virtual_cell

NUMBERS = {FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_INT64, FieldDescriptor.CPPTYPE_BOOL}
STATES = {FieldDescriptor.CPPTYPE_ENUM, FieldDescriptor.CPPTYPE_STRING}
FOLDER = Path(__file__).parents[2] / "deploy" / "foxglove"
STEP = re.compile(r"(\w+)(?:\[(\d+)\])?")

Messages = dict[str, list[Any]]


@pytest.fixture(scope="module", params=["lab", "dawm"])
def cell(request: pytest.FixtureRequest) -> str:
    """Cells with a layout."""
    return request.param  # type: ignore[no-any-return]


@pytest.fixture(scope="module")
def committed(cell: str) -> dict[str, Any]:
    return json.loads((FOLDER / f"{cell}.json").read_text(encoding="utf-8"))  # type: ignore[no-any-return]


@pytest.fixture(scope="module")
def recorded(cell: str, tmp_path_factory: pytest.TempPathFactory) -> Messages:
    """Every message of a short run in which the gate limits all robots, by topic."""
    file = tmp_path_factory.mktemp("foxglove") / "run.mcap"
    with virtual_cell(cell, record=file) as stack:
        assert isinstance(stack, RecordedCell)
        stack.run_until_ready()
        for name in stack.arms:
            stack.acquire(name, "test")
        for _ in range(4):
            stack.cycle()
            for name, arm in stack.arms.items():
                stack.ask(name, np.full(arm.q.size, 0.5))
        # a virtual cell publishes none
        nearest = NearestPair(
            pair=("fr/link_1", "fr/link_3"), distance_m=1.0, points_m=((0, 0, 0), (0, 0, 1))
        )
        stack.writer.publish(topics.PROXIMITY, Proximity(time_s=0.0, pairs=(nearest,)), stack.time_ns)
    found: Messages = {}
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append(message)
    return found


def resolve(path: str, recorded: Messages) -> FieldDescriptor:
    """The field at a path, which some recorded message has."""
    topic, _, fields = path.partition(".")
    assert topic in recorded, f"{topic} is not recorded; there are {sorted(recorded)}"
    values, field = recorded[topic], None
    for step in fields.split("."):
        parsed = STEP.fullmatch(step)
        assert parsed, f"{path}: {step} is no field"
        field = values[0].DESCRIPTOR.fields_by_name.get(parsed[1])
        assert field is not None, f"{path}: {values[0].DESCRIPTOR.full_name} has no field {parsed[1]}"
        assert field.is_repeated == (parsed[2] is not None), path
        values = [getattr(value, parsed[1]) for value in values]
        if parsed[2] is not None:
            values = [value[int(parsed[2])] for value in values if len(value) > int(parsed[2])]
        assert values, f"no recorded message has {path}"
    assert field is not None
    return field


def panels_in(node: Any) -> Iterator[str]:
    if isinstance(node, str):
        yield node
    else:
        assert 0 < node["splitPercentage"] < 100
        yield from panels_in(node["first"])
        yield from panels_in(node["second"])


def test_every_field_is_in_a_recording_and_can_be_shown(
    cell: str, committed: dict[str, Any], recorded: Messages
) -> None:
    paths = []
    for panel, config in committed["configById"].items():
        for path in config.get("paths", ()):
            field = resolve(path["value"], recorded)
            shown = NUMBERS if panel.startswith("Plot!") else STATES
            assert field.cpp_type in shown, path
            paths.append(path["value"])
    assert len(paths) == len(set(paths)) == {"lab": 26, "dawm": 23}[cell]


def test_the_view_shows_frames_that_a_recording_has(committed: dict[str, Any], recorded: Messages) -> None:
    view = committed["configById"]["3D!cell"]
    assert set(view["topics"]) <= set(recorded)
    parents = {item.parent_frame_id for message in recorded["/tf"] for item in message.transforms}
    assert parents == {view["followTf"]} == {view["layers"]["grid"]["frameId"]}


def test_panels_and_layout_places_correspond(committed: dict[str, Any]) -> None:
    placed = list(panels_in(committed["layout"]))
    assert sorted(placed) == sorted(committed["configById"])
