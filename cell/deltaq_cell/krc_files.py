"""The files that a robot's KRC has loaded, checked against the cell's description of the robot."""

from pathlib import Path

from deltaq_cell.description import RobotDescription, RsiDescription
from deltaq_cell.find import resolve_near, same_to_a_krc
from deltaq_protocol.rsi import AxisMap, EthernetConfig, EthernetConfigError, load_ethernet_xml
from deltaq_protocol.rsi.judge import Finding, Station, judge
from deltaq_protocol.rsi.judge_program import RsiContext, judge_context, judge_program, parse_context
from deltaq_protocol.xml_text import xml_text

MAX_BYTES = 1 << 20
"""A context of RSI 4 carries RSI Visual's catalogue of objects, some 120 KB."""


def station_of(robot: RobotDescription, driver: RsiDescription, cycle_s: float | None = None) -> Station:
    """The PC's end of a robot's RSI, from the robot's description.

    Raises:
        EthernetConfigError: a joint is no RSI axis.
    """
    axes = AxisMap.of(robot.joint_names, robot.units, driver.krc)
    return Station(axes, driver.address, driver.port, driver.inputs, driver.outputs, driver.stop, cycle_s)


def judge_krc_files(cell_file: Path, robot: RobotDescription, cycle_s: float) -> tuple[Finding, ...]:
    """Check the files that the KRC of a robot has loaded: its `*_ethernet.xml`, and contexts and programs that use it.

    Args:
        cell_file: the cell's file; the files that it names are looked up beside it.
        robot: the robot.
        cycle_s: the cell's cycle [s].

    Returns:
        Problems, errors first; empty for a robot that has no KRC.

    Raises:
        FileNotFoundError: the `*_ethernet.xml` is nowhere.
    """
    driver = robot.driver
    if not isinstance(driver, RsiDescription):
        return ()
    path = resolve_near(cell_file, driver.ethernet_xml)
    try:
        station = station_of(robot, driver, cycle_s)
        config = load_ethernet_xml(path)
        found = [*judge(config, station), *_beside(path, config, station)]
    except EthernetConfigError as error:
        return (Finding("error", "file", str(error).removeprefix(f"{path.name}: "), source=path.name),)
    return tuple(sorted(found, key=lambda finding: finding.severity))


def _beside(path: Path, config: EthernetConfig, station: Station) -> list[Finding]:
    # a KRC's names ignore case
    own = path.name.lower()
    contexts = [
        context
        for file in _texts(path, ".rsi.xml", ".rsix")
        if own in file[1].lower() and (context := _context(*file)) is not None and context.ethernet(path.name)
    ]
    # a program names the context with or without its suffix, or, on a KR C2, the *_ethernet.xml
    stems = [context.source.lower().partition(".rsi")[0] for context in contexts]
    names = [own, *stems, *(f"{stem}{suffix}" for stem in stems for suffix in (".rsi", ".rsix"))]
    programs = [
        file for file in _texts(path, ".src") if any(f'"{name}"' in file[1].lower() for name in names)
    ]
    twins = [path.name, *(context.source for context in contexts), *(name for name, _ in programs)]
    found = _twins(path.parent, twins)
    found += [finding for context in contexts for finding in judge_context(context, config, station)]
    found += [finding for name, text in programs for finding in judge_program(text, name, station)]
    if not contexts and not station.emulated and station.axes.krc == "krc4":
        found.append(
            Finding(
                "warning",
                "Precision",
                "the number of decimals that the KRC sends is not known here, and its default is one; "
                "put the context that loads this file beside it, or check with `deltaq krc sniff`",
                bound=4,
                source=path.name,
            )
        )
    return found


def _twins(folder: Path, names: list[str]) -> list[Finding]:
    """An error for each name that a KRC cannot tell from another of the folder."""
    found: dict[str, Finding] = {}
    for name in names:
        same = [file.name for file in same_to_a_krc(folder, name)]
        if len(same) > 1:
            message = f"{' and '.join(same)} are the same name to a KRC; keep the loaded file"
            found[name.lower()] = Finding("error", "file", message, source=name)
    return list(found.values())


def _context(name: str, text: str) -> RsiContext | None:
    try:
        return parse_context(text, name)
    except EthernetConfigError:
        return None  # an unrelated file that happens to name this one


def _texts(path: Path, *suffixes: str) -> list[tuple[str, str]]:
    """Name and text of every file beside `path` that ends so, in any case, is of reasonable size and can be read."""
    texts = []
    for file in sorted(path.parent.iterdir()):
        try:
            if file.name.lower().endswith(suffixes) and file.stat().st_size <= MAX_BYTES:
                texts.append((file.name, _text(file)))
        except OSError:
            continue  # a folder, or an unreadable file
    return texts


def _text(file: Path) -> str:
    data = file.read_bytes()
    try:
        return xml_text(data)
    except ValueError:  # a program, with umlauts of any code page
        return data.decode("utf-8", errors="replace")
