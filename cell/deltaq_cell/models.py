"""Robot models by name or path: their URDF text, without loading any kinematics or meshes."""

from __future__ import annotations

import difflib
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from deltaq_cell.packages import SCHEMES, find_file
from deltaq_protocol.errors import DeltaqError

SHIPPED: dict[str, str] = {
    "dawm": "dawm/dawm.urdf",
    "kr16": "kr16/kr16.urdf",
    "kr16_gantry": "kr16/kr16_gantry.urdf",
}
"""Models that come with deltaq: name to file below `robots/`."""

ROBOTS = Path(__file__).parent / "robots"


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
        """A copy of the XML that may be changed.

        Raises:
            RobotModelError: the text is no XML.
        """
        try:
            return ElementTree.fromstring(self.text)
        except ElementTree.ParseError as error:
            raise RobotModelError(f"{self.source}: not a URDF model: {error}", ("model",)) from None


def load_urdf(model: str | Path) -> Urdf:
    """Find a robot's URDF.

    Args:
        model: name of a shipped model (`kr16`), path of a URDF file, or `package://` and a path within a package
            (see `deltaq_cell.packages.find_file`).

    Raises:
        RobotModelError: no such model or file, or the file is not text.
    """
    path = _model_file(str(model))
    try:
        return Urdf(path.read_text(encoding="utf-8"), str(path), path.resolve().parent)
    except UnicodeDecodeError as error:
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
    if not path.is_file():
        raise RobotModelError(
            f"no robot model '{model}': it is neither a file nor one of {', '.join(sorted(SHIPPED))}",
            ("model",),
            nearest_name(model, SHIPPED),
        )
    return path


def collision_names(urdf: Urdf) -> dict[str, list[str]]:
    """Names of every link's collision bodies, in the order of the URDF.

    A link's only body has the link's name; of several each adds its own name, or its number from 1.

    Raises:
        RobotModelError: the text is no XML.
    """
    names: dict[str, list[str]] = {}
    for link in urdf.tree().iter("link"):
        bodies = link.findall("collision")
        link_name = link.get("name", "")
        names[link_name] = [
            link_name if len(bodies) == 1 else f"{link_name}_{body.get('name') or index}"
            for index, body in enumerate(bodies, start=1)
        ]
    return names
