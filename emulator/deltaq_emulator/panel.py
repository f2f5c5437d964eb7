"""The operator's side of the emulated controller: one JSON object in, one out.

| request | what |
| --- | --- |
| `{"op": "status"}` | nothing but the answer, which every request gets |
| `{"op": "acknowledge"}`, `{"op": "confirm"}`, `{"op": "stop"}` | what the pendant's keys do |
| `{"op": "restart"}` | start the program again |
| `{"op": "restart", "correction": "relative"}` | start one that calls RSI_ON(#RELATIVE), or `"absolute"` |
| `{"op": "mode", "mode": "T1"}` | T1, T2 or AUT |
| `{"op": "drives", "on": false}` | switch the drives |
| `{"op": "input", "name": "gripper_closed", "value": true}` | set a digital input |
| `{"op": "fault", "link": "from_pc", "drop": 0.1}` | faults of the network: `to_pc`, `from_pc` or `both` ways |
| `{"op": "fault", "freeze_cycles": 20}`, `{"op": "fault", "ipoc_shift_ms": -24}` | of the controller |
| `{"op": "fault", "correction": "relative"}` | RSI adds corrections up from now on, or no longer: `"absolute"` |
| `{"op": "fault", "forge": [{"ipoc_shift": 7000}, {"offset_deg": 1.4}]}` | others send, after each telegram, these |
| `{"op": "fault"}` | no more faults |
| `{"op": "await", "state": "stopped", "at_rest": true, "cycles": 5, "within_s": 10}` | answer once all this holds |

The answer is the status with `"ok": true`, or `{"ok": false, "error": …}`. It comes at once, except to `await`.
"""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from deltaq_emulator.drives import REST_TOLERANCE
from deltaq_emulator.faults import FaultyLink, Forgery, LinkFaults
from deltaq_emulator.krc import Krc
from deltaq_emulator.recorder import CsvRecorder
from deltaq_emulator.settings import CorrectionMode, OperatingMode
from deltaq_emulator.states import KrcState
from deltaq_protocol.errors import DeltaqError

MAX_REQUEST_BYTES = 4096
MAX_FORGERIES = 16
"""Forged telegrams a cycle."""
MAX_AWAITED = 64
"""Requests whose answer may be awaited at one time."""


class _Request(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Simple(_Request):
    op: Literal["status", "acknowledge", "confirm", "stop"]


class _Restart(_Request):
    op: Literal["restart"]
    correction: CorrectionMode | None = None


class _SetMode(_Request):
    op: Literal["mode"]
    mode: OperatingMode


class _SetDrives(_Request):
    op: Literal["drives"]
    on: bool


class _SetInput(_Request):
    op: Literal["input"]
    name: str
    value: bool


class _Fault(LinkFaults):
    op: Literal["fault"]
    link: Literal["to_pc", "from_pc", "both"] = "both"
    freeze_cycles: Annotated[int, Field(ge=0, le=100_000)] | None = None
    ipoc_shift_ms: Annotated[int, Field(gt=-(2**32), lt=2**32)] | None = None
    correction: CorrectionMode | None = None
    forge: Annotated[tuple[Forgery, ...], Field(max_length=MAX_FORGERIES)] = ()


class _Await(_Request):
    op: Literal["await"]
    state: KrcState | None = None
    at_rest: bool = False
    cycles: Annotated[int, Field(ge=0, le=100_000)] = 0
    within_s: Annotated[float, Field(gt=0, le=600)] = 10.0


@dataclass(frozen=True)
class _Awaiting:
    """One request that awaits a state: from which cycle on, and until which."""

    request: _Await
    answer: Callable[[bytes], None]
    from_cycle: int
    last_cycle: int


REQUESTS: TypeAdapter[Any] = TypeAdapter(
    Annotated[
        _Simple | _Restart | _SetMode | _SetDrives | _SetInput | _Fault | _Await,
        Field(discriminator="op"),
    ]
)


class Panel:
    """Answers the operator.

    Args:
        robot: its name in the cell.
        krc: the controller.
        to_pc: link on which telegrams leave; from_pc: link on which replies arrive.
        recorder: writes records.
        shell_counts: counters of the shell, to be shown in the status.
    """

    def __init__(
        self,
        robot: str,
        krc: Krc,
        to_pc: FaultyLink,
        from_pc: FaultyLink,
        recorder: CsvRecorder,
        shell_counts: Callable[[], Mapping[str, int]] = dict,
    ) -> None:
        self._robot = robot
        self._krc = krc
        self._links = {"to_pc": to_pc, "from_pc": from_pc}
        self._recorder = recorder
        self._shell_counts = shell_counts
        self._awaiting: list[_Awaiting] = []
        self.forgeries: tuple[Forgery, ...] = ()
        """Forged telegrams that follow each telegram to the PC."""

    def take(self, datagram: bytes, answer: Callable[[bytes], None]) -> None:
        """Carry out a request; `answer` is called exactly once, and no error is raised.

        If the request awaits a state, `cycle_passed` may answer it later.
        """
        try:
            if len(datagram) > MAX_REQUEST_BYTES:
                raise DeltaqError(f"a request has at most {MAX_REQUEST_BYTES} bytes, got {len(datagram)}")
            request = REQUESTS.validate_json(datagram)
            if isinstance(request, _Await):
                self._await(request, answer)
                return
            self._do(request)
            answer(self._done())
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(part) for part in first["loc"]) or "request"
            answer(_refused(f"{where}: {first['msg']}"))
        except DeltaqError as error:
            answer(_refused(str(error)))

    def cycle_passed(self) -> None:
        """Answer the waiting requests that are met or timed out."""
        awaiting, self._awaiting = self._awaiting, []
        for one in awaiting:
            self._answer_or_keep(one)

    def status(self) -> dict[str, Any]:
        """The pendant's display, and every counter."""
        sample = self._krc.sample
        return {
            "robot": self._robot,
            "state": self._krc.state,
            "mode": self._krc.mode,
            "correction": self._krc.correction,
            "message": None if self._krc.message is None else str(self._krc.message),
            "text": self._krc.text,
            "cycle": sample.cycle,
            "ipoc": sample.ipoc,
            "q": sample.q.tolist(),
            "q_setpoint": sample.q_setpoint.tolist(),
            "inputs": dict(self._krc.inputs),
            "outputs": dict(self._krc.outputs),
            "counters": dict(sample.counters) | dict(self._shell_counts()),
            "faults": {
                name: link.faults.model_dump() | {"counts": dict(link.counts)}
                for name, link in self._links.items()
            },
            "forged": [forgery.model_dump() for forgery in self.forgeries],
            "record": None if self._recorder.path is None else str(self._recorder.path),
            "record_error": self._recorder.error,
        }

    def _await(self, request: _Await, answer: Callable[[bytes], None]) -> None:
        if len(self._awaiting) >= MAX_AWAITED:
            raise DeltaqError(f"{MAX_AWAITED} requests await their answer already")
        cycle = self._krc.sample.cycle
        within = math.ceil(request.within_s / self._krc.cycle_s)
        self._answer_or_keep(_Awaiting(request, answer, cycle, cycle + within))

    def _answer_or_keep(self, one: _Awaiting) -> None:
        request, sample = one.request, self._krc.sample
        off = float(np.abs(sample.q - sample.q_setpoint).max())
        came = (
            request.state in (None, self._krc.state)
            and (not request.at_rest or off <= REST_TOLERANCE)
            and sample.cycle >= one.from_cycle + request.cycles
        )
        if came:
            one.answer(self._done())
        elif sample.cycle >= one.last_cycle:
            one.answer(
                _refused(
                    f"not within {request.within_s:g} s: {self._krc.state}, {off:.6f} rad or m off the setpoint, "
                    f"{sample.cycle - one.from_cycle} cycles later"
                )
            )
        else:
            self._awaiting.append(one)

    def _done(self) -> bytes:
        return json.dumps({"ok": True} | self.status()).encode()

    def _do(self, request: Any) -> None:
        match request:
            case _Simple(op="acknowledge"):
                self._krc.acknowledge()
            case _Simple(op="confirm"):
                self._krc.confirm()
            case _Restart():
                self._krc.restart(request.correction)
            case _Simple(op="stop"):
                self._krc.stop()
            case _SetMode():
                self._krc.set_mode(request.mode)
            case _SetDrives():
                self._krc.set_drives(request.on)
            case _SetInput():
                self._krc.set_input(request.name, request.value)
            case _Fault():
                self._inject(request)

    def _inject(self, fault: _Fault) -> None:
        if fault.freeze_cycles is not None:
            self._krc.freeze(fault.freeze_cycles)
        if fault.ipoc_shift_ms is not None:
            self._krc.shift_ipoc(fault.ipoc_shift_ms)
        if fault.correction is not None:
            self._krc.turn(fault.correction)
        of_link = fault.model_dump(include=set(LinkFaults.model_fields))
        lasting = {*LinkFaults.model_fields, "forge"}
        if (
            fault.model_fields_set & {"freeze_cycles", "ipoc_shift_ms", "correction"}
            and not fault.model_fields_set & lasting
        ):
            return
        self.forgeries = fault.forge
        for name, link in self._links.items():
            if fault.link in (name, "both"):
                link.faults = LinkFaults(**of_link)


def _refused(error: str) -> bytes:
    return json.dumps({"ok": False, "error": error}).encode()
