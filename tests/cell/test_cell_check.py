"""`check_cell`: what a schema cannot see, each with its place."""

import re
from pathlib import Path

import pytest

from deltaq_cell.check import check_cell
from deltaq_cell.find import find_cell, resolve_near

LAB = find_cell("lab").read_text(encoding="utf-8")


def checked(folder: Path, *edits: tuple[str, str]) -> tuple[Path, list[str]]:
    text = LAB
    for old, new in edits:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return path, text.splitlines()


@pytest.mark.parametrize("name", ["dawm", "lab", "lab-4ms", "lab-aside", "lab-open", "lab-tools"])
def test_the_shipped_cells_are_sound(name: str) -> None:
    report = check_cell(name)
    assert report.problems == ()
    assert report.ok
    told = report.as_dict()
    assert (told["cell"], told["ok"], told["problems"]) == (name, True, [])
    assert all(told["never_checked"].values())


def test_emulated_drives_that_lag_more_than_the_gate_presumes_are_an_error_for_each_robot(
    tmp_path: Path,
) -> None:
    path, lines = checked(tmp_path, ("servo_lag_s: 0.204", "servo_lag_s: 0.18"))
    for robot, problem in zip(("fr", "gr"), check_cell(path).errors, strict=True):
        assert (problem.field, problem.value, problem.bound) == ("gate.servo_lag_s", 0.18, 0.204)
        assert "servo_lag_s" in lines[problem.line - 1]
        assert problem.message == (
            f"0.18 s is less than the emulated drives of {robot} take for 95% of a step (robots.{robot}.servo_lag: "
            "0.189 s); set at least 0.204, or quicker drives"
        )


# edits, field, words in the line it points at, value, bound, suggestion, part of the message
UNSOUND = [
    ([("model: kr16\n", "model: kr61\n")], "robots.fr.model", "kr61", None, None, "kr16", "no robot model"),
    ([("model: kr16_gantry", "model: kr16")], "robots.gr.joints", "joints:", None, None, None, "expected a1"),
    ([("link: link_1,", "link: link1,")], "robots.gr.attachments.utility_plate.link", "utility_plate", None, None,
     "link_1", "no link 'link1'"),
    ([("[floor, fr_plate]", "[floor, frplate]")], "robots.fr.mounted_on.1", "mounted_on", "frplate", None, "fr_plate",
     "no body 'frplate'"),
    ([("lower_deg: -180", "lower_deg: -190")], "robots.fr.joints.a1.lower_deg", "a1:", -190, -185, None, "below"),
    ([("upper_deg: 30", "upper_deg: 36")], "robots.fr.joints.a2.upper_deg", "a2:", 36, 35, None, "above"),
    ([("upper_m: 1.54", "upper_m: 2")], "robots.gr.joints.e1.upper_m", "e1:", 2, 1.54, None, "above"),
    ([("lower_m: -1.60", "lower_m: -1.7")], "robots.gr.joints.e3.lower_m", "e3:", -1.7, -1.6, None, "below"),
    ([("max_velocity_deg_s: 330", "max_velocity_deg_s: 400")], "robots.fr.joints.a4.max_velocity_deg_s", "a4:", 400,
     330, None, "above"),
    ([("cycle_s: 0.012", "cycle_s: 0.012\nsim: tls/10.0.0.1:7450")], "robots.fr.server", "fr:", "local", None, None,
     "every service of the guarded realm has to be"),
    ([("cycle_s: 0.012", "cycle_s: 0.012\nsim: tcp/10.0.0.1:7450")], "sim", "sim:", "tcp/10.0.0.1:7450", None, None,
     "plain tcp/ lets all of them in"),
    ([("tcp_port: 5210", "tcp_port: 7447")], "tcp_port", "tcp_port", 7447, None, None, "that of hli"),
    ([("hli: tcp/127.0.0.1:7447", "hli: tcp/0.0.0.0:7447")], "hli", "7447", "tcp/0.0.0.0:7447", None, None,
     "would need no token to move the robots"),
    ([("tcp_address: 127.0.0.1", "tcp_address: 192.0.2.1")], "tcp_address", "192.0.2.1", "192.0.2.1", None, None,
     "would need no token to move the robots"),
    ([("control_port: 28153", "control_port: 49152")], "robots.gr.driver.control_port", "49152", 49152, None, None,
     "that of robots.fr.driver.port"),
    ([("cycle_s: 0.012", "cycle_s: 0.012\nsim: tls/127.0.0.1:70000")], "sim", "70000", "tls/127.0.0.1:70000",
     "local or tls/HOST:PORT", None, "with a port of 1 to 65535, got 'tls/127.0.0.1:70000'"),
    ([("hli: tcp/127.0.0.1:7447", "hli: udp/127.0.0.1:7447")], "hli", "udp", "udp/127.0.0.1:7447",
     "tcp/HOST:PORT, tcp+udp/HOST:PORT or tls/HOST:PORT", None, "should be tcp/HOST:PORT, tcp+udp/HOST:PORT or tls"),
    ([("retreat_speed: 0.1", "gate_timeout_s: 0.02")], "gate.gate_timeout_s", "0.02", 0.02, 0.024, None,
     "less than two cycles"),
    ([("fr_ethernet.xml", "none.xml")], "robots.fr.driver.ethernet_xml", "none.xml", "none.xml", None, None,
     "no file 'none.xml'"),
    ([("bodies: [wheel_1, valve_1]", "bodies: [weel_1, valve_1]")], "equipment.valve_1.bodies.0", "bodies", "weel_1",
     None, "wheel_1", "no body of the structure is named 'weel_1'"),
    ([("turns: 2, contact: gripper_on_valves", "turns: 2, contact: gripper_on_valve")], "equipment.valve_1.contact",
     "contact", "gripper_on_valve", None, "gripper_on_valves", "no contact is named"),
    ([("{kind: gauge, bodies: [pipe_4]", "{kind: gauge, robot: grr, bodies: [pipe_4]")], "equipment.gauge_1.robot",
     "gauge_1", "grr", None, "gr", "no robot is named"),
    ([("kind: lever", "kind: leaver")], "equipment.lever_1.kind", "leaver", "leaver", None, "lever", "must be one of"),
    ([("axis: [0, 1, 0], ", "")], "equipment.valve_1", "valve_1:", None, None, None, "a valve needs axis, such as"),
    ([("axis: [0, 1, 0]", "axis: [0, 0, 0]")], "equipment.valve_1", "valve_1:", None, None, None,
     "axis is no direction"),
    ([("reach_m: 0.14", "reach_m: .nan")], "equipment.valve_3.reach_m", "reach_m", "nan", None, None, "finite"),
]  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize(
    ("edits", "field", "line", "value", "bound", "suggestion", "message"),
    UNSOUND,
    ids=[row[1] for row in UNSOUND],
)
def test_an_unsound_description_is_reported_with_its_place(
    tmp_path: Path,
    edits: list[tuple[str, str]],
    field: str,
    line: str,
    value: object,
    bound: object,
    suggestion: str | None,
    message: str,
) -> None:
    path, lines = checked(tmp_path, *edits)
    report = check_cell(path)
    (problem,) = [p for p in report.problems if p.field == field]
    assert not report.ok
    assert problem.file == "mine.yaml"
    assert line in lines[problem.line - 1]
    assert problem.value == value or (isinstance(value, float) and problem.value == pytest.approx(value))
    assert bound is None or problem.bound == pytest.approx(bound)
    assert problem.suggestion == suggestion
    assert message in problem.message


@pytest.mark.by_day(3)
@pytest.mark.parametrize(("cycle", "krc", "sound"), [
    (0.012, "krc2", True), (0.024, "krc2", False), (0.004, "krc2", False),
    (0.004, "krc4", True), (0.008, "krc4", False), (0.012, "krc4", True), (0.010, "krc4", False),
])  # fmt: skip
def test_the_cycle_is_one_that_the_krc_can_have(tmp_path: Path, cycle: float, krc: str, sound: bool) -> None:
    path, _ = checked(tmp_path, ("cycle_s: 0.012", f"cycle_s: {cycle}"))
    path.write_text(path.read_text().replace("krc: krc2", f"krc: {krc}"))
    found = [p for p in check_cell(path).errors if p.field == "cycle_s"]
    assert len(found) == (0 if sound else 2)  # one for each robot
    assert all("is not the cycle of" in p.message for p in found)


@pytest.mark.parametrize(
    ("old", "new", "field", "port"),
    [
        ("control_port: 28152", "control_port: 49252", "robots.fr.driver.control_port", 49252),
        ("hli: tcp/127.0.0.1:7447", "hli: tcp/127.0.0.1:32768", "hli", 32768),
        ("tcp_port: 5210", "tcp_port: 5210\nconsole_port: 60999", "console_port", 60999),
    ],
)
def test_a_port_in_the_ephemeral_range_is_a_warning(
    tmp_path: Path, old: str, new: str, field: str, port: int
) -> None:
    path, lines = checked(tmp_path, (old, new))
    report = check_cell(path)
    (problem,) = report.problems
    assert report.ok
    assert (problem.field, problem.value, problem.bound) == (field, port, 32767)
    assert "choose one below 32768" in problem.message
    assert str(port) in lines[problem.line - 1]


def test_a_console_has_a_port_of_its_own(tmp_path: Path) -> None:
    path, _ = checked(tmp_path, ("tcp_port: 5210", "tcp_port: 5210\nconsole_port: 5210"))
    (problem,) = check_cell(path).problems
    assert problem.field == "console_port"
    assert "that of tcp_port" in problem.message


def test_a_tolerance_wider_than_the_stop_distance_is_a_warning(tmp_path: Path) -> None:
    old = "max_acceleration_rad_s2: 10.9, tracking_tolerance_deg: 0.05"
    path, _ = checked(tmp_path, (old, old.replace("0.05", "2")))
    report = check_cell(path)
    (problem,) = report.problems
    assert report.ok
    assert (problem.severity, problem.field) == ("warning", "robots.fr.joints.a1.tracking_tolerance_deg")
    assert problem.value == pytest.approx(2)
    assert isinstance(problem.bound, float)
    assert 1 < problem.bound < 2


def test_a_home_in_contact_is_reported_with_both_bodies(tmp_path: Path) -> None:
    path, _ = checked(tmp_path, ("e3: {home_m: -0.175", "e3: {home_m: -1.3"))
    report = check_cell(path)
    assert report.errors
    assert all(p.field == "robots.gr.joints" and "stop distance" in p.message for p in report.errors)
    assert any(re.search(r"gr/\w+ and structure/\w+", p.message) for p in report.errors)


def test_a_robot_in_undeclared_contact_with_the_floor_is_reported(tmp_path: Path) -> None:
    path, _ = checked(tmp_path, ("mounted_on: [rail_south, rail_north]", "mounted_on: [rail_south]"))
    assert any("structure/rail_north" in p.message for p in check_cell(path).errors)


def test_an_unloadable_file_is_reported_without_an_exception(tmp_path: Path) -> None:
    report = check_cell(tmp_path / "gone.yaml")
    assert [p.message for p in report.errors] == ["no such file"]
    path, _ = checked(tmp_path, ("cycle_s: 0.012", "cycle_s: -1"))
    assert [p.field for p in check_cell(path).errors] == ["cycle_s"]


def test_an_unknown_body_in_a_contact_is_answered_with_the_nearest_name(tmp_path: Path) -> None:
    path, _ = checked(tmp_path, ("bodies: [gr/tool_gripper,", "bodies: [gr/tool_griper,"))
    report = check_cell(path)
    assert [problem.field for problem in report.problems] == ["contacts.gripper_on_valves.bodies.0"]
    assert "no body is named 'gr/tool_griper' on a robot" in report.problems[0].message
    assert report.problems[0].suggestion == "gr/tool_gripper"


# edits of the KRC's file, edits of the cell, field, words in the line it points at, value, bound, severity, message
KRC_FILES = [
    ([('INDX="2" UNIT="0" HOLDON="1"', 'INDX="2" UNIT="0" HOLDON="0"')], [], "ethernet_xml", 0, 1, "error",
     "mine_ethernet.xml: RECEIVE/AK.A2: HOLDON is 0"),
    ([("DEF_ASPos", "DEF_RSol")], [], "ethernet_xml", None, None, "warning", "SEND/DEF_ASPos: is missing"),
    ([], [("control_port: 28152, stop: Stop", "control_port: 28152, stop: Halt")], "stop", "Halt",
     "Stop", "error", "RECEIVE/Halt: no BOOL has that TAG"),
    ([], [("address: 127.0.0.1, port: 49152", "address: 192.168.10.20, krc_address: 192.168.10.30, port: 49152")],
     "address", "192.168.10.10", "192.168.10.20", "error", "CONFIG/IP_NUMBER: is 192.168.10.10"),
    ([(">49152<", ">49153<")],
     [("address: 127.0.0.1, port: 49152", "address: 192.168.10.10, krc_address: 192.168.10.30, port: 49152")],
     "port", 49153, 49152, "error", "CONFIG/PORT: is 49153"),
    ([("</ROOT>", "")], [], "ethernet_xml", None, None, "error", "mine_ethernet.xml: file: is no XML document"),
]  # fmt: skip


@pytest.mark.by_day(3)
@pytest.mark.long
@pytest.mark.parametrize(
    ("file_edits", "cell_edits", "field", "value", "bound", "severity", "message"),
    KRC_FILES,
    ids=[row[6] for row in KRC_FILES],
)
def test_a_mismatching_krc_file_is_reported_at_its_field(
    tmp_path: Path,
    file_edits: list[tuple[str, str]],
    cell_edits: list[tuple[str, str]],
    field: str,
    value: object,
    bound: object,
    severity: str,
    message: str,
) -> None:
    xml = resolve_near(find_cell("lab"), "fr_ethernet.xml").read_text(encoding="utf-8")
    for old, new in file_edits:
        assert old in xml
        xml = xml.replace(old, new)
    (tmp_path / "mine_ethernet.xml").write_text(xml, encoding="utf-8")
    path, lines = checked(tmp_path, *cell_edits, ("fr_ethernet.xml", "mine_ethernet.xml"))
    problems = [
        problem for problem in check_cell(path).problems if problem.field == f"robots.fr.driver.{field}"
    ]
    (problem,) = [problem for problem in problems if message in problem.message]
    assert problem.severity == severity
    assert (problem.value, problem.bound) == (value, bound)
    assert "kind: rsi" in lines[problem.line - 1]


def test_contexts_and_programs_beside_the_krc_file_are_checked_too(tmp_path: Path) -> None:
    xml = resolve_near(find_cell("lab"), "fr_ethernet.xml").read_text(encoding="utf-8")
    (tmp_path / "fr_ethernet.xml").write_text(xml, encoding="utf-8")
    (tmp_path / "fr.rsi.xml").write_text(
        '<RSIObjects><RSIObject ObjType="ETHERNET" ObjID="ETHERNET1"><Parameters>'
        '<Parameter Name="ConfigFile" ParamValue="fr_ethernet.xml"/></Parameters></RSIObject></RSIObjects>'
    )
    (tmp_path / "fr.src").write_text('ret = RSI_CREATE("fr.rsi", id, TRUE)\nret = RSI_ON(#RELATIVE)\n')
    (tmp_path / "other.src").write_text('ret = RSI_CREATE("other.rsi", id, TRUE)\nret = RSI_ON(#RELATIVE)\n')
    (tmp_path / "other.rsi.xml").write_text("<Nothing/> about fr_ethernet.xml")
    path, _ = checked(tmp_path)
    messages = [problem.message for problem in check_cell(path).problems]
    assert [message.split(": ")[1] for message in messages if message.startswith("fr.rsi.xml")] == [
        *(f"AXISCORR/CorrA{i}" for i in range(1, 7)),
        "STOP/Stop",
        "ETHERNET1/Precision",
    ]
    assert [message for message in messages if ".src: " in message] == [
        message for message in messages if message.startswith("fr.src: RSI_ON: corrections are relative")
    ]
    assert any(message.startswith("fr.src") for message in messages)


@pytest.mark.parametrize(
    ("named", "context", "config_file", "program", "created"),
    [
        ("fr_ethernet.xml", "fr.rsi.xml", "fr_ethernet.xml", "GO.SRC", "fr.rsi"),
        ("fr_ethernet.xml", "fr.rsi.xml", "fr_ethernet.xml", "go.src", "FR.rsi"),
        ("fr_ethernet.xml", "FR.RSI.XML", "Fr_Ethernet.xml", "go.src", "fr.rsi"),
        ("Fr_Ethernet.XML", "fr.rsi.xml", "fr_ethernet.xml", "go.src", "fr.rsi"),
        ("Fr_Ethernet.XML", "unrelated.rsi.xml", "other.xml", "go.src", "FR_ethernet.xml"),
    ],
)
def test_names_of_krc_files_ignore_case(
    tmp_path: Path, named: str, context: str, config_file: str, program: str, created: str
) -> None:
    xml = resolve_near(find_cell("lab"), "fr_ethernet.xml").read_text(encoding="utf-8")
    (tmp_path / "fr_ethernet.xml").write_text(xml, encoding="utf-8")
    (tmp_path / context).write_text(
        '<RSIObjects><RSIObject ObjType="ETHERNET" ObjID="ETHERNET1"><Parameters>'
        f'<Parameter Name="ConfigFile" ParamValue="{config_file}"/></Parameters></RSIObject></RSIObjects>'
    )
    (tmp_path / program).write_text(f'ret = RSI_CREATE("{created}", id, TRUE)\nret = RSI_ON(#RELATIVE)\n')
    path, _ = checked(tmp_path, ("fr_ethernet.xml", named))
    messages = [problem.message for problem in check_cell(path).problems]
    assert [
        message for message in messages if message.startswith(f"{program}: RSI_ON: corrections are relative")
    ]
    assert not [message for message in messages if "no file" in message]


def test_krc_files_whose_names_differ_by_case_alone_are_an_error(tmp_path: Path) -> None:
    xml = resolve_near(find_cell("lab"), "fr_ethernet.xml").read_text(encoding="utf-8")
    for name in ("fr_ethernet.xml", "FR_ethernet.xml"):
        (tmp_path / name).write_text(xml, encoding="utf-8")
    for name in ("go.src", "GO.SRC"):
        (tmp_path / name).write_text('ret = RSI_CREATE("fr_ethernet.xml", id, TRUE)\n')
    path, _ = checked(tmp_path)
    twins = [
        problem.message for problem in check_cell(path).errors if "same name to a KRC" in problem.message
    ]
    assert [message.partition(":")[2].partition(" are ")[0] for message in twins] == [
        " file: FR_ethernet.xml and fr_ethernet.xml",
        " file: GO.SRC and go.src",
    ]
    path, _ = checked(tmp_path, ("fr_ethernet.xml", "Fr_ethernet.xml"))
    (missing,) = [problem for problem in check_cell(path).errors if "no file" in problem.message]
    assert "FR_ethernet.xml and fr_ethernet.xml in" in missing.message


@pytest.mark.parametrize(
    ("field", "severities"),
    [("clients_need_tokens", []), ("anyone_who_connects_may_move_the_robots", ["warning"])],
)
def test_beyond_the_loopback_the_check_says_which_clients_may_move_robots(
    tmp_path: Path, field: str, severities: list[str]
) -> None:
    open_address = ("tcp_address: 127.0.0.1", f"tcp_address: 0.0.0.0\n{field}: true")
    path, _ = checked(tmp_path, open_address)
    assert [problem.severity for problem in check_cell(path).problems] == severities


@pytest.mark.parametrize("transport", ["tcp", "tcp+udp"])
def test_with_identities_zenoh_in_the_clear_is_reported_with_field_value_and_remedy(
    tmp_path: Path, transport: str
) -> None:
    value = f"{transport}/192.0.2.1:7447"
    open_address = ("hli: tcp/127.0.0.1:7447", f"hli: {value}\nclients_need_tokens: true")
    path, _ = checked(tmp_path, open_address)
    (problem,) = check_cell(path).problems
    assert (problem.severity, problem.field, problem.value) == ("warning", "hli", value)
    for remedy in ("tls/", "tunnel", "127.0.0.1", "TLS (`tcp_address`)"):
        assert remedy in problem.message
    assert check_cell(path).ok


def test_encrypted_zenoh_gives_no_report(tmp_path: Path) -> None:
    open_address = ("hli: tcp/127.0.0.1:7447", "hli: tls/192.0.2.1:7447\nclients_need_tokens: true")
    path, _ = checked(tmp_path, open_address)
    assert check_cell(path).problems == ()


def test_an_encrypted_address_is_checked_like_any_other(tmp_path: Path) -> None:
    path, _ = checked(tmp_path, ("hli: tcp/127.0.0.1:7447", "hli: tls/192.0.2.1:7447"))
    (problem,) = check_cell(path).problems
    assert (problem.severity, problem.field) == ("error", "hli")
