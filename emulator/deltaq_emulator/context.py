"""Settings of corrections from the files of an RSI application: an RSI context, and the KRL program that starts it.

| file | of | what is read |
| --- | --- | --- |
| `*.rsi.xml`, `*.rsix` | RSI 3; RSI 4 and later | AXISCORR, AXISCORREXT, AXISCORRMON; Timeout, Precision of ETHERNET |
| `*.src` | RSI 3 and later | RSI_ON(#ABSOLUTE) or RSI_ON(#RELATIVE) |
| `*.src` | RSI 2 | ST_AXISCORR and the ST_SETPARAM calls for its handle, where index and value are numbers |

Source: contexts and programs that ROS-Industrial and others publish for KR C2 and KR C4. Objects and parameters that
are not in the table have no effect here.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from pathlib import Path

import numpy as np

from deltaq_emulator.corrections import CorrectionLimits
from deltaq_emulator.settings import CorrectionMode, KrcSettings, SettingsError
from deltaq_protocol.rsi import AxisMap, EthernetConfigError
from deltaq_protocol.rsi.axes import ARM_AXES, EXTERNAL_AXES
from deltaq_protocol.rsi.judge_program import parse_context
from deltaq_protocol.xml_text import xml_text

MAKERS_LIMIT, MAKERS_MONITOR = 5.0, 6.0
"""Limit of an axis that the file does not mention [deg or mm]."""

_CORRECTED_BY = {"AXISCORR": ARM_AXES, "AXISCORREXT": EXTERNAL_AXES}
_RSI2_AXES = (*ARM_AXES, *EXTERNAL_AXES)
_RSI2_MODE, _RSI2_LOWER, _RSI2_UPPER = 1, 2, 14
"""Parameters of RSI 2's ST_AXISCORR: 0 for absolute or 1 for relative; the first of twelve lower limits, of twelve
upper ones."""
_RSI_ON = re.compile(r"\bRSI_ON\s*\(\s*#(ABSOLUTE|RELATIVE)\b", re.IGNORECASE)
_ST_AXISCORR = re.compile(r"\bST_AXISCORR\s*\(\s*(\w+)", re.IGNORECASE)
_ST_SETPARAM = re.compile(r"\bST_SETPARAM\s*\(\s*(\w+)\s*,([^,()]+),([^,()]+)\)", re.IGNORECASE)


@dataclass(frozen=True)
class Context:
    """Settings from the files; None for values that they do not contain.

    Attributes:
        corrected: axes for which there is a correction object.
        lower: per axis the least total correction [deg or mm]; upper: the greatest.
        monitor: per axis the total correction that stops RSI [deg or mm].
        timeout: cycles without a valid reply that are permitted.
        precision: decimals of a DOUBLE in the controller's telegrams.
        correction: the argument of RSI_ON.
    """

    corrected: frozenset[str]
    lower: Mapping[str, float]
    upper: Mapping[str, float]
    monitor: Mapping[str, float]
    timeout: int | None = None
    precision: int | None = None
    correction: CorrectionMode | None = None

    def over(self, other: Context) -> Context:
        """Both; where both give a value, this one counts."""
        return Context(
            self.corrected | other.corrected,
            {**other.lower, **self.lower},
            {**other.upper, **self.upper},
            {**other.monitor, **self.monitor},
            other.timeout if self.timeout is None else self.timeout,
            other.precision if self.precision is None else self.precision,
            self.correction or other.correction,
        )

    def settings(self, settings: KrcSettings) -> KrcSettings:
        """These settings, replaced by the values that the files give."""
        said = {"late_budget": self.timeout, "precision": self.precision, "correction": self.correction}
        return settings.model_copy(update={name: value for name, value in said.items() if value is not None})

    def limits(self, axes: AxisMap, settings: KrcSettings) -> CorrectionLimits:
        """Limits of each axis; those of the settings if no file has a correction object.

        Raises:
            SettingsError: if there are correction objects, and none for one of the axes.
        """
        of_settings = CorrectionLimits.of(axes, settings)
        if not self.corrected:
            return of_settings
        if missing := [axis for axis in axes.axes if axis not in self.corrected]:
            raise SettingsError(
                f"the context has no correction object for {', '.join(missing)}; "
                "add AXISCORR for A1 to A6, AXISCORREXT for E1 to E6"
            )

        def bounds(table: Mapping[str, float], default: float) -> list[float]:
            return [table.get(axis, default) for axis in axes.axes]

        return CorrectionLimits(
            np.array(bounds(self.lower, -MAKERS_LIMIT)) / axes.commanded,
            np.array(bounds(self.upper, MAKERS_LIMIT)) / axes.commanded,
            np.array(bounds(self.monitor, MAKERS_MONITOR)) / axes.commanded,
        )


NOTHING = Context(frozenset(), {}, {}, {})
"""No settings from files."""


def read_context(files: Iterable[Path]) -> Context:
    """Read the files of one RSI application; where two give the same value, the later one counts.

    Raises:
        SettingsError: if a file cannot be read, or a value in it is not allowed.
    """
    return reduce(lambda so_far, file: _read(file).over(so_far), files, NOTHING)


def _read(file: Path) -> Context:
    try:
        data = file.read_bytes()
    except OSError as error:
        raise SettingsError(f"{file}: cannot be read: {error}") from error
    if file.suffix.lower() == ".src":
        return parse_program(data.decode("latin-1"), file.name)
    return parse_context_xml(data, file.name)


def parse_context_xml(data: bytes, source: str) -> Context:
    """Read an RSI context; `source` is its name in messages.

    Raises:
        SettingsError: if it is not a context, or a value in it is not allowed.
    """
    try:
        context = parse_context(xml_text(data), source)
    except EthernetConfigError as error:
        raise SettingsError(str(error)) from error
    except ValueError as error:
        raise SettingsError(f"{source}: is no XML document: {error}") from error
    objects: dict[str, dict[str, str]] = {}
    for thing in context.objects:
        objects.setdefault(thing.kind, {}).update(thing.parameters)
    if not objects:
        raise SettingsError(
            f"{source}: has no RSIObject; give the context (.rsi.xml or .rsix) or a program (.src)"
        )

    def number(kind: str, name: str) -> float:
        return _number(f"{source}: {kind}: {name}", objects[kind][name])

    def table(kinds: Mapping[str, tuple[str, ...]], prefix: str) -> dict[str, float]:
        return {
            axis: number(kind, prefix + axis)
            for kind, axes in kinds.items()
            for axis in axes
            if prefix + axis in objects.get(kind, {})
        }

    def count(name: str, lowest: int, highest: int) -> int | None:
        if name not in objects.get("ETHERNET", {}):
            return None
        value = number("ETHERNET", name)
        if value != int(value) or not lowest <= value <= highest:
            raise SettingsError(
                f"{source}: ETHERNET: {name} is {value:g}, allowed is {lowest} to {highest}, whole numbers"
            )
        return int(value)

    corrected = frozenset(axis for kind, axes in _CORRECTED_BY.items() if kind in objects for axis in axes)
    lower, upper = table(_CORRECTED_BY, "LowerLim"), table(_CORRECTED_BY, "UpperLim")
    _check(source, lower, upper)
    monitor = table({"AXISCORRMON": _RSI2_AXES}, "Max")
    return Context(corrected, lower, upper, monitor, count("Timeout", 0, 2**31 - 1), count("Precision", 1, 9))


def parse_program(text: str, source: str) -> Context:
    """Read a KRL program; `source` is its name in messages.

    Raises:
        SettingsError: if a limit is not written out as a number, or not allowed.
    """
    lines = [line.partition(";")[0] for line in text.splitlines()]
    code = "\n".join(lines)
    handles = {match[1].lower() for match in _ST_AXISCORR.finditer(code)}
    lower: dict[str, float] = {}
    upper: dict[str, float] = {}
    correction: CorrectionMode | None = None
    if (match := _RSI_ON.search(code)) is not None:
        correction = "relative" if match[1].upper() == "RELATIVE" else "absolute"
    for line_number, line in enumerate(lines, start=1):
        match = _ST_SETPARAM.search(line)
        if match is None or match[1].lower() not in handles:
            continue
        where = f"{source}:{line_number}: ST_SETPARAM of {match[1]}"
        parameter, value = _number(where, match[2]), _number(where, match[3])
        if parameter == _RSI2_MODE:
            correction = "relative" if value else "absolute"
        for first, bounds in ((_RSI2_LOWER, lower), (_RSI2_UPPER, upper)):
            if first <= parameter < first + len(_RSI2_AXES):
                bounds[_RSI2_AXES[int(parameter) - first]] = value
    _check(source, lower, upper)
    corrected = frozenset(_RSI2_AXES) if handles else frozenset()
    return Context(corrected, lower, upper, {}, correction=correction)


def _number(where: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise SettingsError(f"{where} is {text.strip()[:40]!r}, allowed is a number")
    return value


def _check(source: str, lower: Mapping[str, float], upper: Mapping[str, float]) -> None:
    for axis in (*lower, *upper):
        low, high = lower.get(axis, -MAKERS_LIMIT), upper.get(axis, MAKERS_LIMIT)
        if not low <= 0.0 <= high:
            raise SettingsError(
                f"{source}: correction of {axis} is limited to {low:g} … {high:g}; 0, where RSI starts, must lie within"
            )
