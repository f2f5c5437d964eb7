"""Whatever stands in a cell's file, `deltaq check` says what is wrong with it and never fails itself."""

import json
import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from deltaq_cell.check import CheckReport, check_cell
from deltaq_cell.yaml_tree import parse
from deltaq_deploy.command.app import app

CELL = """\
cell: small
cycle_s: 0.012
gate: {stop_distance_m: 0.05, servo_lag_s: 0.204}
robots:
  fr:
    model: kr16
    server: tcp/127.0.0.1:7451
    driver:
      {kind: rsi, address: 127.0.0.1, port: 49152, ethernet_xml: gr_ethernet.xml, krc: krc2,
       control_port: 28152, outputs: {gripper: Do.O1}, stop: Stop}
    base: {position_m: [-0.402, 0.486, 0.0], rpy_deg: [0, 0, -90]}
    mounted_on: [floor]
    joints:
      a1: &slow
        {home_deg: 0, lower_deg: -120, upper_deg: 30, max_velocity_deg_s: 156, max_acceleration_rad_s2: 4.5,
         tracking_tolerance_deg: 1}
      a2: *slow
      a3: {<<: *slow, upper_deg: 139}
      a4: {home_deg: 0, lower_deg: -345, upper_deg: 345, max_velocity_deg_s: 330, max_acceleration_rad_s2: 92.8}
      a5: {home_deg: 60, lower_deg: -125, upper_deg: 125, max_velocity_deg_s: 330, max_acceleration_rad_s2: 89.3}
      a6: {home_deg: 0, lower_deg: -345, upper_deg: 345, max_velocity_deg_s: 615, max_acceleration_rad_s2: 120}
    camera: {pose: {position_m: [0, 0, 0.17], rpy_deg: [0, 0, 180]}, vertical_view_deg: 45}
    tool:
      frame: {position_m: [0, 0, 0.17]}
      bodies:
        gripper: {shape: {kind: box, size_m: [0.06, 0.26, 0.07]}, pose: {position_m: [0, 0, 0.105]}}
    attachments:
      plate: {link: link_1, shape: {kind: sphere, radius_m: 0.1}, pose: {position_m: [0.1, 0.3, 0.0]}}
    outputs: [gripper]
structure:
  floor: {shape: {kind: box, size_m: [8, 10, 0.2]}, pose: {position_m: [0, 0, -0.111]}, colour_rgba: [0.4, 0.4, 0.4, 1]}
"""

VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=8)
    | st.sampled_from(
        [10**400, -1, 0, 1e-300, 1e300, math.nan, math.inf, "a1", "fr", "floor", "lab", "kr16"]
    ),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)
SNIPPETS = st.sampled_from(
    ["&a", "*a", "<<: *a", "!!python/object:os.system", "!!binary x", "\t", "\0", "{", "[", "]", "\n", ": ", "- ", "'",
     "|", "%YAML 9.9\n", "---\n", "...\n", "extends: lab\n", "extends: mine.yaml\n", "? ", "2001-01-01", "0x", "\ud800"]
)  # fmt: skip
fuzzed = settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])


def tree() -> Any:
    return parse(CELL, "small.yaml").plain()


def places(node: Any) -> list[tuple[Any, Any]]:
    """Every map or list with each of its keys or indices."""
    found: list[tuple[Any, Any]] = []
    if isinstance(node, dict | list):
        for key, below in list(node.items() if isinstance(node, dict) else enumerate(node)):
            found += [(node, key), *places(below)]
    return found


def checked(folder: Path, text: str | bytes) -> CheckReport:
    file = folder / "mine.yaml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode(errors="surrogatepass"))
    report = check_cell(file)
    for problem in report.problems:
        assert problem.message
        assert str(problem)
    json.dumps(report.as_dict())
    return report


def test_the_cell_that_is_mutated_is_sound(tmp_path: Path) -> None:
    assert checked(tmp_path, CELL).problems == ()


@pytest.mark.long
@fuzzed
@given(
    place=st.integers(0, 10**6),
    how=st.sampled_from(["replace", "remove", "rename", "swap"]),
    value=VALUES,
    other=st.integers(0, 10**6),
)
def test_the_check_survives_replaced_removed_renamed_and_swapped_fields(
    tmp_path: Path, place: int, how: str, value: Any, other: int
) -> None:
    cell = tree()
    everywhere = places(cell)
    node, key = everywhere[place % len(everywhere)]
    elsewhere, key_there = everywhere[other % len(everywhere)]
    if how == "replace":
        node[key] = value
    elif how == "remove":
        del node[key]
    elif how == "rename" and isinstance(node, dict):
        node[value if isinstance(value, str | int) else "?"] = node.pop(key)
    else:
        node[key] = elsewhere[key_there]
    try:
        text = yaml.safe_dump(cell, sort_keys=False)
    except (ValueError, RecursionError, yaml.YAMLError):
        return  # a map in itself, or a text that YAML cannot hold
    checked(tmp_path, text)


@pytest.mark.long
@fuzzed
@given(
    cuts=st.lists(
        st.tuples(st.integers(0, len(CELL)), st.integers(0, 40), SNIPPETS | st.text(max_size=3)),
        min_size=1,
        max_size=3,
    )
)
def test_the_check_survives_text_cut_and_patched_anywhere(
    tmp_path: Path, cuts: list[tuple[int, int, str]]
) -> None:
    text = CELL
    for start, length, patch in cuts:
        text = text[:start] + patch + text[start + length :]
    checked(tmp_path, text)


@fuzzed
@example(b"\xff\xfe\x00")
@given(st.binary(max_size=200))
def test_bytes_that_are_no_text_are_reported(tmp_path: Path, content: bytes) -> None:
    assert not checked(tmp_path, content).ok


LAUGHS = "\n".join(
    ["a0: &a0 [x, x]"] + [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 12)]
)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "x",
        "[]",
        "- 1",
        "cell: &a [*a]",
        "[" * 600,
        "{a: " * 600,
        LAUGHS,
        "extends: mine.yaml",
        "&a {cell: *a}",
    ],
    ids=[
        "empty",
        "word",
        "list",
        "item",
        "itself",
        "deep list",
        "deep map",
        "laughs",
        "extends itself",
        "map in itself",
    ],
)
def test_deep_endless_or_empty_input_is_reported(tmp_path: Path, text: str) -> None:
    assert not checked(tmp_path, text).ok


@pytest.mark.parametrize("text", ["{", "cycle_s: .nan", "cell: " + "x" * 10_000, "\0"])
def test_the_command_ends_with_status_1_and_a_line_and_no_traceback(tmp_path: Path, text: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(text, encoding="utf-8")
    done = CliRunner().invoke(app, ["check", "--cell", str(file)], catch_exceptions=False)
    assert done.exit_code == 1
    assert done.output.startswith("error: ")
