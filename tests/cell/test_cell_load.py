"""Loading a cell: every way a file can be wrong is told with its place, all at once."""

import math
import re
import sys
from pathlib import Path

import pytest
from ran import ran

from deltaq_cell.description import RobotDescription
from deltaq_cell.description.bodies import VIDEO_FORMS
from deltaq_cell.description.robot import DRIVES, ServoLag
from deltaq_cell.find import find_cell
from deltaq_cell.load import load_cell, load_with_text, parse_cell
from deltaq_cell.problems import CellError, Problem
from deltaq_cell.yaml_tree import parse

MINI = """\
cell: mini
cycle_s: 0.012
robots:
  fr:
    model: kr16
    server: tcp/127.0.0.1:7451
    driver: {kind: kinematic}
    joints:
      a1: {home_deg: 0, lower_deg: -180, upper_deg: 180, max_velocity_deg_s: 156, max_acceleration_rad_s2: 10}
      a2:
        home_deg: -90
        lower_deg: -150
        upper_deg: 30
        max_velocity_deg_s: 156
        max_acceleration_rad_s2: 4.5
structure:
  pipe:
    shape: {kind: cylinder, radius_m: 0.1, length_m: 1}
    pose:
      position_m: [0, 1, 2]
gate:
  stop_distance_m: 0.05
"""


def write(folder: Path, text: str, name: str = "lab.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def problems(path: Path | str) -> tuple[Problem, ...]:
    with pytest.raises(CellError) as caught:
        load_cell(path)
    assert str(caught.value) == "\n".join(str(problem) for problem in caught.value.problems)
    return caught.value.problems


def only(path: Path | str) -> Problem:
    (problem,) = problems(path)
    return problem


def test_a_good_file_loads(tmp_path: Path) -> None:
    cell = load_cell(write(tmp_path, MINI))
    assert cell.cell == "mini"
    assert cell.robots["fr"].joint_names == ("a1", "a2")
    assert cell.structure["pipe"].pose.position_m == (0, 1, 2)
    assert load_with_text(tmp_path / "lab.yaml")[1] == MINI
    assert parse_cell(MINI) == cell


def test_an_unknown_field_is_named_with_file_line_and_suggestion(tmp_path: Path) -> None:
    text = MINI.replace("    driver: {", "    basee: {}\n    driver: {")
    problem = only(write(tmp_path, text))
    assert str(problem) == "lab.yaml:7: robots.fr.basee: not a field here; did you mean 'base'?"
    assert (problem.file, problem.line, problem.field) == ("lab.yaml", 7, "robots.fr.basee")
    assert problem.suggestion == "base"


def test_an_unknown_field_without_a_similar_name_is_answered_with_all_fields(tmp_path: Path) -> None:
    problem = only(write(tmp_path, MINI.replace("gate:", "gate:\n  zzz: 1")))
    assert problem.line == 22
    assert problem.suggestion is None
    assert "the fields here are gate_timeout_s, hli_timeout_s" in problem.message


# old text, new text, line, field, value, bound, part of the message
WRONG = [
    ("cycle_s: 0.012", "cycle_s: 0.5", 2, "cycle_s", 0.5, 0.1, "should be less than or equal to 0.1, got 0.5"),
    ("cycle_s: 0.012", "cycle_s: fast", 2, "cycle_s", "fast", None, "should be a valid number, got 'fast'"),
    ("cycle_s: 0.012", 'cycle_s: "0.012"', 2, "cycle_s", "0.012", None, "should be a valid number, got '0.012'"),
    ("cycle_s: 0.012", "cycle_s: yes_", 2, "cycle_s", "yes_", None, "valid number"),
    ("cycle_s: 0.012", "cycle_s: true", 2, "cycle_s", True, None, "should be a valid number, got True"),
    ("cycle_s: 0.012", "cycle_s: .nan", 2, "cycle_s", "nan", 0.1, "got 'nan'"),
    ("cycle_s: 0.012", "cycle_s:", 2, "cycle_s", None, None, "should be a valid number"),
    ("stop_distance_m: 0.05", "stop_distance_m: .inf", 22, "gate.stop_distance_m", "inf", None, "finite number"),
    ("stop_distance_m: 0.05", "stop_distance_m: .nan", 22, "gate.stop_distance_m", "nan", None, "got 'nan'"),
    ("stop_distance_m: 0.05", "stop_distance_m: 0", 22, "gate.stop_distance_m", 0, 0, "greater than 0, got 0"),
    ("stop_distance_m: 0.05", "stop_distance_m: [1]", 22, "gate.stop_distance_m", None, None, "got a list"),
    ("[0, 1, 2]", "[0, 1]", 20, "structure.pipe.pose.position_m.2", None, None, "is missing"),
    ("[0, 1, 2]", "[0, one, 2]", 20, "structure.pipe.pose.position_m.1", "one", None, "valid number"),
    ("radius_m: 0.1", "radius_m: -1", 18, "structure.pipe.shape.radius_m", -1, 0, "greater than 0"),
    ("radius_m: 0.1, ", "", 18, "structure.pipe.shape.radius_m", None, None, "is missing"),
    ("kind: cylinder, ", "", 18, "structure.pipe.shape.kind", None, None, "is missing"),
    ("cell: mini", "cell: Mini cell", 1, "cell", "Mini cell", "^[a-z][a-z0-9_-]*$", "pattern"),
    ("cell: mini\n", "", 1, "cell", None, None, "is missing"),
    ("tcp/127.0.0.1:7451", "127.0.0.1", 6, "robots.fr.server", "127.0.0.1", "local or tls/HOST:PORT",
     "a port of 1 to 65535"),
    ("  fr:", "  FR:", 4, "robots.FR", "FR", "^[a-z][a-z0-9_-]*$", "pattern"),
    ("lower_deg: -150", "lower_deg: 40", 10, "robots.fr.joints.a2", None, None,
     "lower_deg 40 must be below upper_deg 30"),
    ("home_deg: -90", "home_deg: 90", 10, "robots.fr.joints.a2", None, None,
     "home_deg 90 must lie between lower_deg -150"),
    ("        home_deg: -90\n", "", 10, "robots.fr.joints.a2", None, None, "a joint needs home_deg"),
    *(("    driver: {", f"    camera: {{source: '{source}'}}\n    driver: {{", 7, "robots.fr.camera.source", source,
       VIDEO_FORMS, "should be test, v4l2:/dev/NAME")
      for source in ("tset", "rtsp://eye:secret@host/1", "http://host/1.mp4", "v4l2:video0")),
    ("    driver: {", "    camera: {source: test, source_right: test}\n    driver: {", 7, "robots.fr.camera", None,
     None, "source_right is test, and source test with baseline_m 0"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "line", "field", "value", "bound", "message"), WRONG)
def test_a_wrong_value_is_reported_with_line_field_value_and_bound(
    tmp_path: Path, old: str, new: str, line: int, field: str, value: object, bound: object, message: str
) -> None:
    assert old in MINI
    problem = only(write(tmp_path, MINI.replace(old, new, 1)))
    assert (problem.line, problem.field) == (line, field), str(problem)
    assert (problem.value, problem.bound) == (value, bound)
    assert type(problem.value) is type(value)
    assert message in problem.message


@pytest.mark.parametrize(
    ("old", "new", "field", "suggestion"),
    [
        ("kind: cylinder", "kind: cylindre", "structure.pipe.shape.kind", "cylinder"),
        ("kind: kinematic", "kind: kinematik", "robots.fr.driver.kind", "kinematic"),
    ],
)
def test_an_unknown_kind_is_answered_with_the_known_kinds(
    tmp_path: Path, old: str, new: str, field: str, suggestion: str
) -> None:
    problem = only(write(tmp_path, MINI.replace(old, new)))
    assert (problem.field, problem.suggestion) == (field, suggestion)
    assert suggestion in str(problem.bound)
    assert f"did you mean '{suggestion}'?" in problem.message


def test_an_unknown_krc_is_answered_with_the_known_ones(tmp_path: Path) -> None:
    driver = "{kind: rsi, port: 49152, ethernet_xml: fr.xml, krc: krc3}"
    problem = only(write(tmp_path, MINI.replace("{kind: kinematic}", driver)))
    assert (problem.line, problem.field, problem.value) == (7, "robots.fr.driver.krc", "krc3")
    assert problem.bound == "krc2, krc4"


def test_all_errors_of_a_file_are_reported_together(tmp_path: Path) -> None:
    text = MINI.replace("0.012", "-1").replace("radius_m", "radius").replace("model: kr16", "modell: kr16")
    told = problems(write(tmp_path, text))
    assert [problem.line for problem in told] == sorted(problem.line for problem in told)
    assert sorted(problem.field for problem in told) == [
        "cycle_s",
        "robots.fr.model",
        "robots.fr.modell",
        "structure.pipe.shape.radius",
        "structure.pipe.shape.radius_m",
    ]


# text, line, part of the message
NO_CELL = [
    ("", 0, "is empty"),
    ("# only a comment\n", 0, "is empty"),
    ("- a\n- b\n", 1, "must be a mapping"),
    ("just words\n", 1, "must be a mapping"),
    ("cell: a\ncell: b\n", 2, "the key 'cell' is there twice"),
    (MINI.replace("  fr:\n", "  fr:\n    base: {}\n    base: {}\n"), 6, "the key 'base' is there twice"),
    ("cell: [a, b\ncycle_s: 1\n", 2, "not YAML: "),
    ("cell: a\n\tcycle_s: 1\n", 2, "not YAML: "),
    ("cell: *nowhere\n", 1, "not YAML: found undefined alias 'nowhere'"),
    ("cell: a\n---\ncell: b\n", 2, "not YAML: expected a single document"),
    ("cell: a\x00\n", 0, "not YAML: "),
    ("cell: a\n1: b\n", 2, "the key 1 must be text"),
    ("a: " + "[" * 30 + "]" * 30, 1, "nested deeper than 24"),
    ("a: " + "[" * 400 + "]" * 400, 1, "nested deeper than 24"),
    ("[" * (1 << 19), 1, "nested deeper than 24"),
    ("cell: a\n? [b]\n: c\n", 2, "not YAML: "),
    ("cell: &a\n  b: *a\n", 2, "the value of alias 'a' would contain itself"),
    ("cell: &a b\ncycle_s: &a 1\n", 2, "the anchor 'a' is there twice"),
    ("- " * (1 << 18), 1, "nested deeper than 24"),
    ("cell: !!binary aaaa\n", 1, "is not supported here"),
    ("cell: a\n<<: 3\n", 2, "'<<' merges a mapping"),
    ("a: &a [1]\n" + "".join(f"b{i}: &b{i} [{', '.join([f'*b{i - 1}' if i else '*a'] * 10)}]\n" for i in range(9)),
     None, "look at its aliases"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "line", "message"), NO_CELL, ids=[row[2] + str(row[1]) for row in NO_CELL])
def test_yaml_other_than_a_mapping_is_reported_with_its_line(
    tmp_path: Path, text: str, line: int | None, message: str
) -> None:
    problem = only(write(tmp_path, text))
    assert problem.file == "lab.yaml"
    assert message in problem.message
    assert line is None or problem.line == line


WORDS = [
    ("no", "no"), ("yes", "yes"), ("on", "on"), ("true", True), ("FALSE", False), ("~", None), ("", None), ("'1'", "1"),
    ("010", 10), ("0o10", 8), ("0x1F", 31), ("+12", 12), ("1e3", 1000.0), ("1e-05", 1e-05), (".5", 0.5),
    ("-.inf", -math.inf), ("1:30", "1:30"), ("2001-01-01", "2001-01-01"), ("1_000", "1_000"),
    ("!!str 1", "1"), ("!!float 1", 1.0),
]  # fmt: skip


@pytest.mark.parametrize(("word", "value"), WORDS, ids=[row[0] or "nothing" for row in WORDS])
def test_scalars_follow_the_core_schema_of_yaml_1_2(word: str, value: object) -> None:
    found = parse(f"a: {word}\n", "words.yaml").plain()["a"]
    assert (type(found), found) == (type(value), value)


def test_own_keys_precede_merged_keys_and_earlier_merges_precede_later_ones() -> None:
    text = "a: &a {x: 1, y: 1}\nb: &b {y: 2, z: 2}\nc:\n  <<: [*a, *b]\n  x: 3\n"
    tree = parse(text, "merge.yaml")
    assert tree.plain()["c"] == {"x": 3, "y": 1, "z": 2}
    (merged, _) = tree.find(("c", "z"))
    assert (merged.file, merged.line) == ("merge.yaml", 4)


def test_a_value_that_contains_itself_is_an_error(tmp_path: Path) -> None:
    assert problems(write(tmp_path, MINI.replace("[0, 1, 2]", "&p [*p, *p, *p]")))


def test_a_file_other_than_utf_8_is_reported_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"
    path.write_bytes(b"cell: lab\n# gr\xfcn\n")
    problem = only(path)
    assert (problem.line, problem.message) == (2, "is not UTF-8 text; save it as UTF-8")


def test_a_huge_file_is_refused_without_reading_it(tmp_path: Path) -> None:
    problem = only(write(tmp_path, "# " + "x" * (1 << 20)))
    assert "too large" in problem.message
    assert problem.bound == 1 << 20


def test_a_cell_extends_another_and_changes_only_what_it_names(tmp_path: Path) -> None:
    write(tmp_path, MINI, "base.yaml")
    text = "extends: base.yaml\ncell: other\nrobots: {fr: {joints: {a2: {upper_deg: 20}}}}\n"
    base, other = load_cell(tmp_path / "base.yaml"), load_cell(write(tmp_path, text))
    assert other.cell == "other"
    assert other.robots["fr"].joints["a2"].upper_deg == 20
    assert other.robots["fr"].joint_names == base.robots["fr"].joint_names
    assert other.robots["fr"].joints["a1"] == base.robots["fr"].joints["a1"]
    assert parse_cell(load_with_text(tmp_path / "lab.yaml")[1]) == other  # the text stands alone


def test_errors_of_an_extended_cell_name_the_file_with_the_error(tmp_path: Path) -> None:
    write(tmp_path, MINI.replace("radius_m: 0.1", "radius_m: -1"), "base.yaml")
    text = "extends: base.yaml\ngate:\n  stop_distance_m: -2\n"
    found = {(problem.file, problem.line, problem.field) for problem in problems(write(tmp_path, text))}
    assert found == {
        ("base.yaml", 18, "structure.pipe.shape.radius_m"),
        ("lab.yaml", 3, "gate.stop_distance_m"),
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cell: a\nextends: bass.yaml\n", "did you mean 'base.yaml'?"),
        ("cell: a\nextends: [base.yaml]\n", "the name or the path of one cell"),
        ("cell: a\nextends: lab.yaml\n", "extends this file in turn"),
        ("cell: a\nextends: circle.yaml\n", "extends this file in turn"),
    ],
)
def test_an_invalid_extension_is_reported(tmp_path: Path, text: str, message: str) -> None:
    write(tmp_path, MINI, "base.yaml")
    write(tmp_path, "extends: lab.yaml\n", "circle.yaml")
    problem = only(write(tmp_path, text))
    assert message in problem.message
    assert problem.field == "extends"


def test_an_extension_of_a_broken_file_points_into_that_file(tmp_path: Path) -> None:
    write(tmp_path, "cell: [\n", "base.yaml")
    assert only(write(tmp_path, "extends: base.yaml\n")).file == "base.yaml"


REMOVED = """\
extends: base.yaml
structure: {pipe: null, post: {shape: {kind: sphere, radius_m: 0.1}}}
robots:
  gr: null
contacts: {touch: null}
"""
TWO_ROBOTS = MINI.replace(
    "structure:\n",
    "  gr: {model: kr16, server: 'tcp/127.0.0.1:7452', driver: {kind: kinematic}, joints: {a1: {home_m: 0, lower_m: 0,"
    " upper_m: 1, max_velocity_m_s: 1, max_acceleration_m_s2: 1}}}\n"
    "contacts: {touch: {bodies: [fr/link_6], against: [structure/pipe]}}\nstructure:\n",
)


def test_null_removes_an_inherited_entry(tmp_path: Path) -> None:
    write(tmp_path, TWO_ROBOTS, "base.yaml")
    assert set(load_cell(tmp_path / "base.yaml").robots) == {"fr", "gr"}
    cell = load_cell(write(tmp_path, REMOVED))
    assert (set(cell.robots), set(cell.structure), set(cell.contacts)) == ({"fr"}, {"post"}, set())
    assert parse_cell(load_with_text(tmp_path / "lab.yaml")[1]) == cell  # the text stands alone


def test_a_removed_entry_may_be_restored_by_a_further_extension(tmp_path: Path) -> None:
    write(tmp_path, MINI, "base.yaml")
    write(tmp_path, "extends: base.yaml\nstructure: {pipe: null}\n", "bare.yaml")
    text = "extends: bare.yaml\nstructure: {pipe: {shape: {kind: sphere, radius_m: 0.2}}}\n"
    pipe = load_cell(write(tmp_path, text)).structure["pipe"]
    assert pipe.shape.kind == "sphere"
    assert pipe.pose.position_m == (0, 0, 0)  # nothing of the old one is left


@pytest.mark.parametrize(
    ("text", "line", "field", "message"),
    [
        (
            "structure:\n  pipes: null\n",
            3,
            "structure.pipes",
            "remove; there is pipe; did you mean 'pipe'?",
        ),
        ("contacts: {touch: null}\n", 2, "contacts.touch", "remove; there is nothing"),
    ],
)
def test_an_absent_entry_cannot_be_removed(
    tmp_path: Path, text: str, line: int, field: str, message: str
) -> None:
    write(tmp_path, MINI, "base.yaml")
    problem = only(write(tmp_path, f"extends: base.yaml\n{text}"))
    assert (problem.line, problem.field) == (line, field)
    assert message in problem.message


def test_null_where_nothing_is_inherited_is_an_error(tmp_path: Path) -> None:
    problem = only(write(tmp_path, MINI.replace("gate:\n", "contacts: {touch: null}\ngate:\n")))
    assert problem.field == "contacts.touch"


def test_a_cell_has_at_most_eight_robots(tmp_path: Path) -> None:
    robot = MINI.split("  fr:\n")[1].split("structure:")[0]
    more = "".join(f"  r{number}:\n{robot}" for number in range(8))
    (problem,) = problems(write(tmp_path, MINI.replace("structure:\n", more + "structure:\n")))
    assert (problem.field, problem.bound) == ("robots", 8)


def test_a_urdf_is_found_beside_the_cells_file(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text("<robot/>")
    cell = load_cell(write(tmp_path, MINI.replace("model: kr16", "model: arm.urdf")))
    assert cell.robots["fr"].model == str(tmp_path / "arm.urdf")


def test_the_shipped_cells_are_found_by_name() -> None:
    assert find_cell("lab").name == "lab.yaml"
    lab, fast = load_cell("lab"), load_cell("lab-4ms")
    assert (lab.cycle_s, fast.cycle_s) == (0.012, 0.004)
    assert fast.robots["gr"].joints == lab.robots["gr"].joints
    assert fast.structure == lab.structure


@pytest.mark.long
def test_loading_a_cell_imports_neither_kinematics_nor_deployment() -> None:
    program = (
        "import sys\n"
        "from deltaq_cell.load import load_cell\n"
        "from deltaq_cell.models import load_urdf\n"
        "cell = load_cell('lab-4ms')\n"
        "assert cell.cycle_s == 0.004 and load_urdf(cell.robots['fr'].model).text\n"
        "heavy = {'pinocchio', 'coal', 'deltaq_deploy'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)\n"
    )
    ran([sys.executable, "-c", program])


def test_a_signal_without_a_tag_in_the_file_of_its_controller_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "cell.yaml"
    file.write_text(
        "extends: lab\nrobots:\n  gr:\n    outputs: [gripper, tool_changer, lamp]\n", encoding="utf-8"
    )
    with pytest.raises(
        CellError, match=r"outputs names gripper, tool_changer, lamp, and driver\.outputs gives a TAG"
    ):
        load_cell(file)


RSI_DRIVER = "driver: {{kind: rsi, port: 49152, ethernet_xml: fr_ethernet.xml, {fields}}}"


def load_with_driver(folder: Path, fields: str) -> None:
    load_cell(write(folder, MINI.replace("driver: {kind: kinematic}", RSI_DRIVER.format(fields=fields))))


@pytest.mark.parametrize("address", ["192.168.10.10", "0.0.0.0", "127.example.org"])
def test_a_server_reachable_from_outside_needs_the_address_of_its_krc(tmp_path, address):
    with pytest.raises(CellError, match=rf"krc_address is not given though address is {re.escape(address)}"):
        load_with_driver(tmp_path, f"address: {address}")
    load_with_driver(tmp_path, f"address: {address}, krc_address: 192.168.10.20")


@pytest.mark.parametrize("address", ["127.0.0.1", "127.9.9.9", "localhost"])
def test_on_the_loopback_the_krc_need_not_be_named(tmp_path, address):
    load_with_driver(tmp_path, f"address: {address}")


def test_the_stop_signal_cannot_be_a_user_output(tmp_path):
    with pytest.raises(CellError, match=r"outputs\.gripper is Stop, which is driver\.stop"):
        load_with_driver(tmp_path, "stop: Stop, outputs: {gripper: Stop}")


@pytest.mark.parametrize("krc", ["krc2", "krc4"])
def test_emulated_drives_have_the_lag_of_their_krc_by_default(krc):
    fr = load_cell("lab").robots["fr"]
    told = fr.model_dump(exclude_unset=True, exclude={"servo_lag"})
    told["driver"]["krc"] = krc
    described = RobotDescription.model_validate(told)
    assert described.servo_lag == DRIVES[krc]
    quick = ServoLag(dead_time_s=0.012, natural_frequency_rad_s=167.0)
    assert RobotDescription.model_validate(told | {"servo_lag": quick.model_dump()}).servo_lag == quick
    mean_s = (
        2 * {"krc2": 0.012, "krc4": 0.004}[krc]
        + DRIVES[krc].dead_time_s
        + 2 / DRIVES[krc].natural_frequency_rad_s
    )
    assert mean_s == pytest.approx({"krc2": 0.12, "krc4": 0.074}[krc])
