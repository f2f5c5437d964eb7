"""The page of gains: the camera controllers', with their values as the code has them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from inspect import getdoc
from typing import Any

from deltaq_controllers.camera import gain_sources
from deltaq_controllers.camera.clear_view import SightGains
from deltaq_controllers.camera.escape.gains import EscapeGains
from deltaq_controllers.camera.gain_sources import GainSource
from deltaq_controllers.camera.gains import FollowerGains, Variants
from deltaq_controllers.camera.qp_gains import QpGains
from deltaq_deploy.command.reference.markdown import table

_HEAD = ("gain", "value", "unit", "stands in", "value chosen by")


def gains() -> str:
    """The tables of gains."""
    variants = getdoc(Variants) or ""
    return "\n\n".join(
        [
            "# Gains of the camera controllers",
            " ".join((gain_sources.__doc__ or "").split("\n\n", 1)[1].split())
            + " [What they do](../explanation/camera-follower.md).",
            "## The paper's law",
            "`FollowerGains`: `paper`, `predictive` and the variants as printed.",
            table(_HEAD, _rows(FollowerGains(), gain_sources.FOLLOWER)),
            " ".join(variants.split("\n\nAttributes:")[0].split("\n\n", 1)[1].split()),
            "## The quadratic programme",
            "`QpGains`: `qp`.",
            table(_HEAD, _rows(QpGains(), gain_sources.QP)),
            "## The line of sight",
            "`SightGains`: `clear-view`, which has those of `qp` besides.",
            table(_HEAD, _rows(SightGains(), gain_sources.SIGHT)),
            "## The courses of an escape",
            "`EscapeGains`: `escape`, which has those of `qp` besides.",
            table(_HEAD, _rows(EscapeGains(), gain_sources.ESCAPE)),
        ]
    )


def _rows(values: Any, sources: Mapping[str, GainSource]) -> Iterable[tuple[str, ...]]:
    for name, value in values._asdict().items():
        yield f"`{name}`", f"{value:.4g}", *sources[name]
