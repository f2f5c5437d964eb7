"""An operator who is no machine: slow to react, noisy, and now and then on the wrong axis or key.

What is assumed, and on whose word:

- Reaction: 0.25 s, differing by a tenth from one operator to the next (simple visual reactions take 0.2 to 0.3 s: Woods
  et al., Front. Hum. Neurosci. 9:131, 2015; the spread is an assumption).
- Noise: a rate deviates by a tenth of the whole command, in all axes of it, with a memory of 0.15 s. That noise grows
  with the signal is Harris and Wolpert's (Nature 394:780, 1998), a tenth the order of what van Beers, Haggard and
  Wolpert find for reaching (J. Neurophysiol. 91:1050, 2004); that it holds for a hand controller, and its memory, are
  assumptions.
- Slips: one action in fifty goes wrong, HEART's figure for a routine, highly practised, rapid task (Williams 1986).
  Which of the kinds in `Slip` it is, all equally likely, is an assumption, and so is that a continuous motion
  consists of an action every 0.6 s. A slip is noticed, and ends, one reaction later.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from deltaq_controllers.modes.motion import OperatorCommand

REACTION_S, REACTION_SPREAD = 0.25, 0.1
NOISE, NOISE_MEMORY_S = 0.1, 0.15
SLIP, ACTION_S = 0.02, 0.6


class Slip(StrEnum):
    """A slip of an operator's hand."""

    AXIS = "wrong axis"
    WAY = "wrong way"
    LATE = "let go too late"
    KEY = "wrong option"


@dataclass(frozen=True)
class Person:
    """One operator.

    Attributes:
        reaction_s: time from what is seen to what is done.
        noise: standard deviation of a rate, over the size of the command.
        slip: probability that an action goes wrong.
    """

    reaction_s: float = REACTION_S
    noise: float = NOISE
    slip: float = SLIP

    @classmethod
    def drawn(cls, generator: np.random.Generator) -> Person:
        """An operator among many."""
        spread = float(np.clip(generator.normal(0.0, REACTION_SPREAD), -0.3, 0.3))
        return cls(reaction_s=REACTION_S * (1.0 + spread))


class OperatorHand:
    """What an operator's hand makes of what is meant.

    Args:
        person: whose hand it is.
        cycle_s: sample time [s].
        generator: of random numbers.

    Attributes:
        slips: how many there were of each kind.
    """

    def __init__(self, person: Person, cycle_s: float, generator: np.random.Generator) -> None:
        self._person, self._cycle_s, self._generator = person, cycle_s, generator
        self._noise: dict[str, float] = {}
        self._meant: OperatorCommand = OperatorCommand()
        self._since_action_s = np.inf
        self._slip: OperatorCommand | None = None
        self._slip_left_s = 0.0
        self.slips: Counter[Slip] = Counter()

    def done(self, meant: OperatorCommand, axes: Mapping[str, float], options: int) -> OperatorCommand:
        """The command that is given where another is meant.

        Args:
            meant: what the operator means to do in this cycle.
            axes: all that the operator may take by mistake, each with its greatest rate [m/s or rad/s].
            options: how many options there are to be mistaken.
        """
        self._begin(meant, axes, options)
        self._meant = meant
        if self._slip is not None:
            self._slip_left_s -= self._cycle_s
            given, self._slip = self._slip, self._slip if self._slip_left_s > 0.0 else None
            return self._noisy(replace(given, mode=meant.mode))
        return self._noisy(meant)

    def _begin(self, meant: OperatorCommand, axes: Mapping[str, float], options: int) -> None:
        """Whether an action begins here, and goes wrong."""
        self._since_action_s += self._cycle_s
        moved, moves = _driven(self._meant), _driven(meant)
        is_new = moves != moved or meant.option != self._meant.option
        if self._slip is not None or not (is_new or (moves and self._since_action_s >= ACTION_S)):
            return
        self._since_action_s = 0.0
        if self._generator.random() >= self._person.slip:
            return
        kinds = []
        if moves:
            kinds = [Slip.AXIS, Slip.WAY] if len(axes) > 1 else [Slip.WAY]
        elif moved:
            kinds = [Slip.LATE]
        elif meant.option is not None and options > 1:
            kinds = [Slip.KEY]
        if kinds:
            kind = kinds[int(self._generator.integers(len(kinds)))]
            self.slips[kind] += 1
            self._slip, self._slip_left_s = (
                self._gone_wrong(kind, meant, axes, options),
                self._person.reaction_s,
            )

    def _gone_wrong(
        self, kind: Slip, meant: OperatorCommand, axes: Mapping[str, float], options: int
    ) -> OperatorCommand:
        if kind is Slip.LATE:
            return replace(meant, rates=self._meant.rates)
        if kind is Slip.WAY:
            return replace(meant, rates={axis: -rate for axis, rate in meant.rates.items()})
        if kind is Slip.KEY:
            others = [option for option in range(1, options + 1) if option != meant.option]
            return replace(meant, option=int(self._generator.choice(others)))
        rates = dict(meant.rates)
        taken = max(rates, key=lambda axis: abs(rates[axis]))
        other = str(self._generator.choice([axis for axis in axes if axis != taken]))
        # the stick is pushed as far as was meant, whatever its axis moves
        share = axes[other] / axes[taken]
        rates[taken], rates[other] = rates.get(other, 0.0) / share, rates[taken] * share
        return replace(meant, rates=rates)

    def _noisy(self, command: OperatorCommand) -> OperatorCommand:
        """The command with noise in proportion to its size, in every axis of its kind."""
        kept = float(np.exp(-self._cycle_s / NOISE_MEMORY_S))
        rates = dict(command.rates)
        for axes in _kinds(rates):
            size = float(np.linalg.norm([rates[axis] for axis in axes]))
            for axis in axes:
                fresh = self._generator.normal(0.0, self._person.noise * np.sqrt(1.0 - kept * kept))
                self._noise[axis] = kept * self._noise.get(axis, 0.0) + fresh
                rates[axis] += size * self._noise[axis]
        return replace(command, rates=rates)


def _driven(command: OperatorCommand) -> frozenset[str]:
    """The axes that a command moves."""
    return frozenset(axis for axis, rate in command.rates.items() if rate != 0.0)


def _kinds(rates: dict[str, float]) -> list[list[str]]:
    """Axes whose rates have one unit and one stick: those along, those about, and each joint by itself."""
    along, about = [
        [axis for axis in rates if axis in group] for group in (("x", "y", "z"), ("rx", "ry", "rz"))
    ]
    return [
        axes for axes in (along, about, *([axis] for axis in rates if axis not in (*along, *about))) if axes
    ]
