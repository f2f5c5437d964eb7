"""Robot models by name or path: their URDF text, without loading any kinematics or meshes."""

import copy
import difflib
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from xml.parsers import expat

from deltaq_cell.find import SCHEMES, find_file, is_file
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.xml_text import xml_text

SHIPPED: dict[str, str] = {
    "dawm": "dawm/dawm.urdf",
    "kr16": "kr16/kr16.urdf",
    "kr16_gantry": "kr16/kr16_gantry.urdf",
}
"""Models that come with deltaq: name to file below `robots/`."""

ROBOTS = Path(__file__).parent / "robots"

MAX_DEPTH = 100
"""Elements within one another in a URDF; extensions of simulators have some 15."""


class RobotModelError(DeltaqError):
    """A robot's model that cannot be found or read, or that does not fit its description.

    Attributes:
        field: path of the field at fault below the robot's own, e.g. `("attachments", "box", "link")`.
        suggestion: the name that was probably meant.
    """

    def __init__(self, message: str, field: tuple[str, ...] = (), suggestion: str | None = None) -> None:
        super().__init__(message + (f"; did you mean '{suggestion}'?" if suggestion else ""))
        self.field = field
        self.suggestion = suggestion


def nearest_name(name: str, allowed: Iterable[str]) -> str | None:
    """The name of `allowed` that `name` was probably meant to be."""
    near = difflib.get_close_matches(name, list(allowed), n=1, cutoff=0.5)
    return near[0] if near else None


@dataclass(frozen=True)
class Urdf:
    """A robot's URDF.

    Attributes:
        text: the XML, as it was written.
        source: the file it came from, for messages; `<text>` if it was given as text.
        folder: folder of that file, from which its meshes are searched for; None if it was given as text.
    """

    text: str
    source: str
    folder: Path | None

    def tree(self) -> ElementTree.Element:
        """A copy of the XML that may be changed: the robot's links and joints, without extensions of simulators.

        Raises:
            RobotModelError: the text is no XML, or no robot.
        """
        return copy.deepcopy(self._robot)

    @cached_property
    def _robot(self) -> ElementTree.Element:
        try:
            robot = _parsed(self.text)
        except (expat.ExpatError, ValueError) as error:
            raise RobotModelError(f"{self.source}: not a URDF model: {error}", ("model",)) from None
        if robot.tag != "robot":
            text = f"{self.source}: not a URDF model: the outermost element is <{robot.tag}>, must be <robot>"
            raise RobotModelError(text, ("model",))
        robot[:] = [child for child in robot if child.tag in ("link", "joint", "material")]
        return robot


def _parsed(text: str) -> ElementTree.Element:
    """The outermost element of an XML text, names as they are written, as urdfdom reads them: no name spaces.

    Raises:
        ExpatError: it is no XML.
        ValueError: it is nested too deep.
    """
    builder, parser, depth = ElementTree.TreeBuilder(), expat.ParserCreate(), 0

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise ValueError(
                f"line {parser.CurrentLineNumber}: more than {MAX_DEPTH} elements within one another"
            )
        builder.start(name, attributes)

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(name)

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = (
        start,
        end,
        builder.data,
    )
    parser.Parse(text, True)
    return builder.close()


def load_urdf(model: str | Path) -> Urdf:
    """Find a robot's URDF.

    Args:
        model: name of a shipped model (`kr16`), path of a URDF file, or `package://` and a path within a package
            (see `deltaq_cell.find.find_file`).

    Raises:
        RobotModelError: no such model or file, or the file cannot be read.
    """
    path = _model_file(str(model))
    try:
        return Urdf(xml_text(path.read_bytes()), str(path), path.resolve().parent)
    except (OSError, ValueError) as error:
        raise RobotModelError(f"{path}: not a URDF model: {error}", ("model",)) from None


def urdf_from_text(text: str) -> Urdf:
    """A URDF that came as text, e.g. over the network; only meshes of installed packages are found."""
    return Urdf(text, "<text>", None)


def _model_file(model: str) -> Path:
    if model.startswith(SCHEMES):
        try:
            return find_file(model)
        except FileNotFoundError as error:
            raise RobotModelError(str(error), ("model",)) from None
    path = ROBOTS / SHIPPED[model] if model in SHIPPED else Path(model)
    if not is_file(path):
        raise RobotModelError(
            f"no robot model '{model}': it is neither a file nor one of {', '.join(sorted(SHIPPED))}",
            ("model",),
            nearest_name(model, SHIPPED),
        )
    return path


def collision_names(urdf: Urdf) -> dict[str, list[str]]:
    """Names of every link's collision bodies, in the order of the URDF, no two alike.

    A link's only body has the link's name; of several each adds its own name, or its number from 1. A name that
    another link or an earlier body has gets `_2`, `_3`, ... added.

    Raises:
        RobotModelError: the text is no XML.
    """
    links = {link.get("name", ""): link.findall("collision") for link in urdf.tree().findall("link")}
    taken = set(links)
    names: dict[str, list[str]] = {}
    for link, bodies in links.items():
        if len(bodies) == 1:
            names[link] = [link]
            continue
        names[link] = []
        for index, body in enumerate(bodies, start=1):
            name = f"{link}_{body.get('name') or index}"
            candidates = (name, *(f"{name}_{number}" for number in range(2, len(taken) + 3)))
            names[link].append(next(name for name in candidates if name not in taken))
            taken.add(names[link][-1])
    return names
