"""`deltaq krc`: the files of a real KRC say what the cell says, read back from what was written."""

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import deltaq_deploy
from deltaq_cell.description import RobotDescription
from deltaq_cell.load import load_cell
from deltaq_deploy.command.app import app
from deltaq_deploy.krc import KrcFilesError, KrcPlan, Start, files_of, plan_for, write_files
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.rsi import AxisMap
from deltaq_protocol.rsi.ethernet_xml import EthernetConfig, parse_ethernet_xml
from deltaq_protocol.rsi.judge import Station, judge
from deltaq_protocol.rsi.judge_program import judge_context, judge_program, parse_context

SHIPPED = Path(deltaq_deploy.__file__).parent / "krc"
CELLS = [
    ("lab", "fr", None),
    ("lab", "gr", None),
    ("lab-4ms", "fr", 3),
    ("lab-4ms", "gr", 3),
    ("lab-4ms", "gr", 4),
]
each_cell = pytest.mark.parametrize(("cell", "robot", "rsi"), CELLS, ids=str)
each_start = pytest.mark.parametrize("start", list(Start))


def written(cell: str, robot: str, **options: object) -> tuple[KrcPlan, dict[str, str]]:
    plan = plan_for(load_cell(cell), robot, **options)  # type: ignore[arg-type] # options of plan_for
    return plan, {file.name: file.text for file in files_of(plan)}


def wire(plan: KrcPlan, texts: dict[str, str]) -> EthernetConfig:
    return parse_ethernet_xml(texts[plan.ethernet_xml], plan.ethernet_xml)


def expected_limits(robot: RobotDescription, start: Start) -> dict[str, tuple[float, float]]:
    """Correction limits [deg or mm], computed from the description alone."""
    factor = np.array([180 / np.pi if unit == "rad" else 1000.0 for unit in robot.units])
    home, lower, upper = robot.home * factor, robot.lower * factor, robot.upper * factor
    low, high = (lower - home, upper - home) if start is Start.HOME else (lower - upper, upper - lower)
    return {
        name.upper(): (float(a), float(b)) for name, a, b in zip(robot.joint_names, low, high, strict=True)
    }


@pytest.mark.parametrize("robot", ["fr", "gr"])
def test_the_shipped_file_agrees_with_the_output_of_the_command(robot: str) -> None:
    _, texts = written("lab", robot, address="192.168.10.10")
    name = f"{robot}_ethernet.xml"
    assert texts[name] == (SHIPPED / name).read_text(encoding="utf-8"), (
        f"write it anew: deltaq krc files --cell lab --robot {robot} --address 192.168.10.10 --output FOLDER"
    )


@each_cell
def test_written_files_pass_the_check_without_findings(cell: str, robot: str, rsi: int | None) -> None:
    description = load_cell(cell).robots[robot]
    plan, texts = written(cell, robot, rsi=rsi, address="192.168.10.10")
    driver = description.driver
    axes = AxisMap.of(description.joint_names, description.units, plan.krc)
    station = Station(
        axes, plan.address, plan.port, driver.inputs, driver.outputs, driver.stop, 0.001 * plan.cycle_ms
    )  # type: ignore[union-attr]
    config = wire(plan, texts)
    assert judge(config, station) == ()
    assert judge_program(texts[f"{plan.program}.src"], "program", station) == ()
    if rsi == 3:
        context = parse_context(texts[f"{plan.program}.rsi.xml"], "context")
        assert judge_context(context, config, station) == ()
        assert context.ethernet(plan.ethernet_xml) is not None


@each_start
@pytest.mark.parametrize("robot", ["fr", "gr"])
def test_a_context_has_the_limits_of_the_cell(robot: str, start: Start) -> None:
    plan, texts = written("lab-4ms", robot, start=start)
    context = parse_context(texts[f"{plan.program}.rsi.xml"], "context")
    (arm,), (monitor,) = context.of_kind("AXISCORR"), context.of_kind("AXISCORRMON")
    external = {
        key: value for thing in context.of_kind("AXISCORREXT") for key, value in thing.parameters.items()
    }
    assert bool(external) == (robot == "gr")
    limits = {**arm.parameters, **external}
    wanted = expected_limits(load_cell("lab-4ms").robots[robot], start)
    assert len(limits) == 2 * len(wanted)
    for axis, (low, high) in wanted.items():
        assert float(limits[f"LowerLim{axis}"]) == pytest.approx(low, abs=1e-4)
        assert float(limits[f"UpperLim{axis}"]) == pytest.approx(high, abs=1e-4)
        assert float(monitor.parameters[f"Max{axis}"]) > max(-low, high)
    assert len(monitor.parameters) == 12


@each_start
@pytest.mark.parametrize("robot", ["fr", "gr"])
def test_a_kr_c2_program_has_the_limits_of_the_cell(robot: str, start: Start) -> None:
    plan, texts = written("lab", robot, start=start)
    calls = re.findall(r"ST_SETPARAM\(hAxis, (\d+), ([-0-9.]+)\)", texts[f"{plan.program}.src"])
    parameters = {int(number): float(value) for number, value in calls}
    assert parameters.pop(1) == 0
    names = [*(f"A{i}" for i in range(1, 7)), *(f"E{i}" for i in range(1, 4))]
    wanted = expected_limits(load_cell("lab").robots[robot], start)
    for number, axis in enumerate(names[: len(wanted)], start=1):
        low, high = wanted[axis]
        assert parameters.pop(number + 1) == pytest.approx(low, abs=1e-4)
        assert parameters.pop(number + 13) == pytest.approx(high, abs=1e-4)
    assert parameters == {}


@pytest.mark.parametrize("robot", ["fr", "gr"])
def test_a_kr_c2_program_links_each_channel_to_its_axis(robot: str) -> None:
    plan, texts = written("lab", robot)
    text = texts[f"{plan.program}.src"]
    links = re.findall(r"ST_NEWLINK\(hEthernet, (\d+), hAxis, (\d+)\)", text)
    channel_of = {element.attribute: element.channel for element in wire(plan, texts).receive}
    axes = [*(f"A{i}" for i in range(1, 7)), *(f"E{i}" for i in range(1, 7))]
    assert {axes[int(number) - 1]: int(channel) for channel, number in links} == {
        axis: channel for axis, channel in channel_of.items() if axis in axes
    }
    stop = next(element for element in wire(plan, texts).receive if element.tag == "Stop")
    assert f"ST_BREAKMOVE(hStop, containerID, hEthernet, {stop.channel})" in text


@each_cell
@each_start
def test_a_program_is_complete_and_declares_its_variables(
    cell: str, robot: str, rsi: int | None, start: Start
) -> None:
    plan, texts = written(cell, robot, rsi=rsi, start=start)
    lines = texts[f"{plan.program}.src"].splitlines()
    code = [line.partition(";")[0].strip() for line in lines]
    code = [line for line in code if line and not line.startswith("&")]
    assert code[0] == f"DEF {plan.program}( )"
    assert code[-1] == "END"
    for opening, closing in (("IF ", "ENDIF"), ("DEF ", "END")):
        opened = [line for line in code if line.startswith(opening)]
        assert len(opened) == code.count(closing)
    folds = [line.split()[0] for line in lines if line.strip().startswith((";FOLD", ";ENDFOLD"))]
    assert folds.count(";FOLD") == folds.count(";ENDFOLD") > 0
    assert max(map(len, lines)) < 140
    declared = set()
    for line in code:
        if match := re.fullmatch(r"(?:DECL )?(?:INT|REAL|CHAR|BOOL|RSIERR) (.+)", line):
            declared |= {name.partition("[")[0].strip() for name in match[1].split(",")}
    used = {match[1] for line in code if (match := re.match(r"(\w+)(?:\[\])? = ", line))}
    used |= {
        name
        for line in code
        for name in re.findall(r"(?:\(|, )([a-z]\w*)(?=[,)\[])", line)
        if name[:4] != "eERX"
    }
    assert used == declared


@pytest.mark.parametrize(("cell", "robot"), [("lab", "gr"), ("lab-4ms", "fr")])
def test_the_start_is_the_home_of_the_cell_or_the_present_position(cell: str, robot: str) -> None:
    description = load_cell(cell).robots[robot]
    factor = [180 / np.pi if unit == "rad" else 1000.0 for unit in description.units]
    home = dict(zip((n.upper() for n in description.joint_names), description.home * factor, strict=True))
    plan, texts = written(cell, robot)
    text = texts[f"{plan.program}.src"]
    places = re.search(r"PTP \{E?6?AXIS: (.*)\}", text)
    assert places is not None
    said = {axis: float(value) for axis, value in (place.split() for place in places[1].split(", "))}
    assert said == pytest.approx({axis: float(value) for axis, value in home.items()}, abs=1e-4)
    assert text.index("PTP $AXIS_ACT") < text.index("PTP {")
    here = written(cell, robot, start=Start.HERE)[1][f"{plan.program}.src"]
    assert "PTP {" not in here
    assert "PTP $AXIS_ACT" in here


@pytest.mark.parametrize(("cell", "option"), [("lab-4ms", "#IPO_FAST"), ("lab-12", "#IPO")])
def test_the_sensor_cycle_is_that_of_the_cell(cell: str, option: str, tmp_path: Path) -> None:
    file = tmp_path / "lab-12.yaml"
    file.write_text("extends: lab\nrobots: {fr: {driver: {krc: krc4}}, gr: {driver: {krc: krc4}}}\n")
    plan, texts = written(str(file) if cell == "lab-12" else cell, "fr")
    assert f"RSI_ON(#ABSOLUTE, {option})" in texts[f"{plan.program}.src"]
    assert 'RSI_CREATE("deltaq_fr.rsi"' in texts["deltaq_fr.src"]


def test_reduced_limits_narrow_every_axis_and_widen_none() -> None:
    plan, _ = written("lab", "gr", limit_deg=5.0, limit_mm=20.0)
    for one in plan.corrections:
        bound = 5.0 if one.unit == "deg" else 20.0
        assert -bound <= one.lower < 0 < one.upper <= bound
    assert min(one.lower for one in plan.corrections) == -20.0


def test_digital_signals_with_given_numbers_are_wired() -> None:
    plan, texts = written("lab-4ms", "gr", digital={"gripper": 12, "tool_locked": 33})
    context = parse_context(texts["deltaq_gr.rsi.xml"], "context")
    (output,), (source,) = context.of_kind("MAP2DIGOUT"), context.of_kind("DIGIN")
    channels = {
        element.tag: element.channel for element in (*wire(plan, texts).receive, *wire(plan, texts).send)
    }
    assert output.inputs == {1: ("ETHERNET1", channels["Do.O1"])}
    assert (output.parameters["Index"], source.parameters["Index"]) == ("12", "33")
    ethernet = context.ethernet("gr_ethernet.xml")
    assert ethernet is not None
    assert ethernet.inputs == {channels["Di.I2"]: (source.name, 1)}


@pytest.mark.parametrize("robot", ["fr", "gr"])
def test_both_files_of_a_context_agree(robot: str) -> None:
    plan, texts = written("lab-4ms", robot, digital={"gripper": 12} if robot == "gr" else None)
    context = parse_context(texts[f"{plan.program}.rsi.xml"], "context")
    space = {"": "http://schemas.microsoft.com/dsltools/RSIVisual"}
    elements = ET.fromstring(texts[f"{plan.program}.rsi"]).findall("rSIObjects/rSIElement", space)
    assert [element.get("name") for element in elements] == [thing.name for thing in context.objects]
    ports = {
        e.get("name"): [p.get("name") for p in e.findall("rSIOutPorts/rSIOutPort", space)] for e in elements
    }
    for element, thing in zip(elements, context.objects, strict=True):
        shown = {p.get("name"): p.get("value") for p in element.findall("rSIParameters/rSIParameter", space)}
        enums = {"DataSize": ("0", "Bit"), "Mode": ("4", "ExitMoveCorr")}
        for name, value in thing.parameters.items():
            assert shown.pop(name) == (enums[name][1] if name in enums else value)
        assert shown == {}
        monikers = [node.get("name", "") for node in element.iter(f"{{{space['']}}}rSIOutPortMoniker")]
        linked = [f"//{source}/{ports[source][output - 1]}" for source, output in thing.inputs.values()]
        assert monikers == linked


def test_every_file_says_that_it_is_untested() -> None:
    for cell, robot, rsi in CELLS:
        for name, text in written(cell, robot, rsi=rsi)[1].items():
            head = " ".join(text[:900].replace(";", " ").split())
            assert "nothing here has been tried on a real controller of that version" in head, name


# --- what cannot be -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cell", "options", "message"),
    [
        ("dawm", {}, "has no KRC: its driver is kinematic"),
        ("lab", {"rsi": 3}, "RSI 3 does not run on a krc2; allowed is 2"),
        ("lab-4ms", {"rsi": 2}, "RSI 2 does not run on a krc4; allowed is 3 or 4"),
        ("lab", {"address": "0.0.0.0"}, "no address that a KRC can send to"),
        ("lab", {"address": "my pc"}, "CONFIG/IP_NUMBER is 'my pc'"),
        ("lab", {"digital": {"gripper": 0}}, "gripper is number 0; a KRC has"),
        ("lab", {"digital": {"grippper": 1}}, "no digital signal 'grippper'; it has gripper_closed"),
    ],
)
def test_a_failed_write_is_reported(cell: str, options: dict[str, object], message: str) -> None:
    robot = "dawm" if cell == "dawm" else "gr"
    with pytest.raises(DeltaqError, match=re.escape(message)):
        written(cell, robot, **options)


def test_an_invalid_tag_is_refused_before_a_file_is_written() -> None:
    cell = load_cell("lab")
    gr = cell.robots["gr"]
    driver = gr.driver.model_copy(update={"outputs": {"gripper": 'x" />', "tool_changer": "Do.O2"}})
    odd = cell.model_copy(update={"robots": {"gr": gr.model_copy(update={"driver": driver})}})
    with pytest.raises(DeltaqError, match="TAG is"):
        files_of(plan_for(odd, "gr"))


def test_a_robot_name_too_long_for_krl_is_reported() -> None:
    cell = load_cell("lab")
    long = "a" * 30
    odd = cell.model_copy(update={"robots": {long: cell.robots["fr"]}})
    with pytest.raises(KrcFilesError, match="37 characters, a name in KRL at most 24"):
        plan_for(odd, long)


def test_existing_files_are_kept_unless_forced(tmp_path: Path) -> None:
    _, texts = written("lab", "fr")
    files = files_of(plan_for(load_cell("lab"), "fr"))
    (tmp_path / "deltaq_fr.src").write_text("mine")
    with pytest.raises(KrcFilesError, match=r"has deltaq_fr\.src already"):
        write_files(files, tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["deltaq_fr.src"]
    assert (tmp_path / "deltaq_fr.src").read_text() == "mine"
    write_files(files, tmp_path, force=True)
    assert {file.name: file.read_text() for file in tmp_path.iterdir()} == texts


def test_an_output_that_is_no_folder_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(KrcFilesError, match="cannot be written to"):
        write_files(files_of(plan_for(load_cell("lab"), "fr")), tmp_path / "file")


def test_the_command_lists_the_files_to_copy_and_their_destination(tmp_path: Path) -> None:
    command = ["krc", "files", "--cell", "lab", "--robot", "gr", "--output", str(tmp_path), "--json"]
    result = CliRunner().invoke(app, command)
    told = json.loads(result.output)
    assert {Path(row["file"]).name: row["copy_to"] for row in told["files"]} == {
        "gr_ethernet.xml": r"C:\KRC\ROBOTER\INIT",
        "deltaq_gr.src": r"C:\KRC\ROBOTER\KRC\R1\Program",
    }
    assert all(Path(row["file"]).is_file() for row in told["files"])
    assert any("no real KRC reaches" in note for note in told["notes"])
    again = CliRunner().invoke(app, command)
    assert isinstance(again.exception, KrcFilesError)


@pytest.mark.parametrize("bad", [["--start", "there"], ["--digital", "gripper"], ["--robot", "xr"]])
def test_wrong_usage_writes_nothing(tmp_path: Path, bad: list[str]) -> None:
    result = CliRunner().invoke(
        app, ["krc", "files", "--cell", "lab", "--robot", "gr", "--output", str(tmp_path / "new"), *bad]
    )
    assert isinstance(result.exception, DeltaqError)
    assert not (tmp_path / "new").exists()
