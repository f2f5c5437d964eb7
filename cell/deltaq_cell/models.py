"""Robot models by name or path: their URDF text, without loading any kinematics."""

from __future__ import annotations

import difflib
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

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
        suggestion: what was probably meant.
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
    """A robot's URDF, and where its meshes are found.

    Attributes:
        text: the XML.
        source: the file it came from, for messages; `<text>` where it came as text.
        package_dirs: folders in which `package://` paths are looked up.
    """

    text: str
    source: str
    package_dirs: tuple[Path, ...]


def load_urdf(model: str | Path) -> Urdf:
    """Find a robot's URDF.

    Args:
        model: name of a shipped model (`kr16`) or path of a URDF file. In a file, mesh names without a scheme
            are taken from its folder, and `package://` is looked up in its folder and those above it.

    Raises:
        RobotModelError: no such model or file, or it is no XML.
    """
    shipped = SHIPPED.get(str(model))
    path = ROBOTS / shipped if shipped else Path(model)
    if not path.is_file():
        raise RobotModelError(
            f"no robot model '{model}': it is neither a file nor one of {', '.join(sorted(SHIPPED))}",
            ("model",),
            nearest_name(str(model), SHIPPED),
        )
    try:
        text = path.read_text(encoding="utf-8")
        root = ElementTree.fromstring(text)
    except (UnicodeDecodeError, ElementTree.ParseError) as error:
        raise RobotModelError(f"{path}: not a URDF file: {error}", ("model",)) from None
    folder = path.resolve().parent
    relative = [mesh for mesh in root.iter("mesh") if "://" not in mesh.get("filename", "")]
    if relative:
        for mesh in relative:
            mesh.set("filename", str(folder / mesh.get("filename", "")))
        text = ElementTree.tostring(root, encoding="unicode")
    return Urdf(text, str(path), (ROBOTS.parents[1], folder, *folder.parents))


def urdf_from_text(text: str) -> Urdf:
    """A URDF that came as text, e.g. over the wire; only the meshes that come with deltaq are found."""
    return Urdf(text, "<text>", (ROBOTS.parents[1],))


def collision_names(urdf: Urdf) -> dict[str, list[str]]:
    """Names of every link's collision bodies, in the order of the URDF.

    A link's only body has the link's name; of several each adds its own name, or its number from 1.

    Raises:
        RobotModelError: the text is no XML.
    """
    try:
        root = ElementTree.fromstring(urdf.text)
    except ElementTree.ParseError as error:
        raise RobotModelError(f"{urdf.source}: not a URDF file: {error}") from None
    names: dict[str, list[str]] = {}
    for link in root.iter("link"):
        bodies = link.findall("collision")
        link_name = link.get("name", "")
        names[link_name] = [
            link_name if len(bodies) == 1 else f"{link_name}_{body.get('name') or index}"
            for index, body in enumerate(bodies, start=1)
        ]
    return names
