"""Invariant I2: proves that no body of a tube comes nearer to another than the stop distance.

A box around windows of a tube is certified at its middle, with every body inflated by how far it can travel
within the box (`deltaq_cell.proximity`). Where that is too coarse the windows are halved, only for those groups
of bodies that failed. Halving ends at single windows, where the inflation is the uncertainty of the drives' lag,
or, where a window is a straight line, at a length that no drive resolves. A budget bounds the work;
when it is used up, the answer is no.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from deltaq_cell.compiled_proximity import CompiledProximity, DistanceQuery
from deltaq_cell.group import Group, Nearest
from deltaq_services.sim.tube import Piece, Windows

NUMERICAL_TOLERANCE_M = 1e-5
"""Added to every stop distance: five times the largest error of coal's iterations, 2e-6 m."""

BUDGET = 24
"""Pieces of tubes that one certifier may measure; few tubes that need more are certified in the end."""


@dataclass(frozen=True)
class Binding:
    """The pair of bodies with the least clearance to spare, where a tube was first measured or where it failed."""

    nearest: Nearest
    stop_distance_m: float

    @property
    def room_m(self) -> float:
        """Swept distance beyond the stop distance; negative where the proof failed."""
        return self.nearest.swept_m - self.stop_distance_m


@dataclass(frozen=True)
class Suspects:
    """Groups at which a certificate failed; `other` is the robot on the other side, None if there is none."""

    other: str | None
    groups: Sequence[Group]


@dataclass(frozen=True)
class Certificate:
    """Whether a tube is certified.

    Attributes:
        holds: whether it is.
        binding: the pair with the least room; None without pairs, or if it was not requested.
        failing: the pairs at which it failed; None if it holds.
    """

    holds: bool
    binding: Binding | None
    failing: Suspects | None = None


class Certifier:
    """Certifies tubes, all within one budget of pieces; `CompiledCertifier` does it in machine code."""

    def __init__(self, proximity: CompiledProximity, budget: int = BUDGET) -> None:
        self._proximity = proximity
        self._left = budget

    def certify(self, robot: str, tube: Windows, others: Sequence[tuple[str, Windows]]) -> Certificate:
        """Certify one robot's tube against the structure, itself and the tubes of others.

        Args:
            robot: name of the robot.
            tube: its tube.
            others: names of other robots with each tube that they may be in.
        """
        certificates = [self.alone(robot, tube, self._proximity.alone[robot])]
        for other, other_tube in others:
            if certificates[-1].holds:
                groups = self._proximity.between[robot, other]
                certificates.append(self.between(robot, tube, other, other_tube, groups))
        if not certificates[-1].holds:
            return certificates[-1]
        bindings = [item.binding for item in certificates if item.binding is not None]
        return Certificate(True, min(bindings, key=lambda item: item.room_m, default=None))

    def judge(
        self,
        robot: str,
        tube: Windows,
        others: Sequence[tuple[str, Windows]],
        suspects: Sequence[Suspects],
    ) -> bool:
        """Whether suspects keep apart; of all other pairs nothing is said."""
        for one in suspects:
            if one.other is None and not self.alone(robot, tube, one.groups).holds:
                return False
            for other, other_tube in others:
                if other == one.other:
                    certificate = self.between(robot, tube, other, other_tube, one.groups)
                    if not certificate.holds:
                        return False
        return True

    def alone(self, robot: str, tube: Windows, groups: Sequence[Group]) -> Certificate:
        """Certify groups of one robot against the structure or itself."""
        least: Binding | None = None
        stack: list[tuple[Piece, Sequence[Group]]] = [(tube, groups)] if groups else []
        while stack:
            piece, groups = stack.pop()
            self._place(robot, piece)
            look, binding = self._measure(groups)
            least = least or binding
            if not look.failing:
                continue
            halves = () if self._hopeless(look) else piece.halves()
            if not halves:
                return Certificate(False, binding, Suspects(None, look.failing))
            stack += [(half, look.failing) for half in halves]
        return Certificate(True, least)

    def between(
        self, robot: str, tube: Windows, other: str, other_tube: Windows, groups: Sequence[Group]
    ) -> Certificate:
        """Certify groups of one robot against another, whose tube is `other_tube`."""
        least: Binding | None = None
        stack: list[tuple[Piece, Piece, Sequence[Group]]] = [(tube, other_tube, groups)] if groups else []
        while stack:
            mine, theirs, groups = stack.pop()
            my_travel = self._place(robot, mine)
            their_travel = self._place(other, theirs)
            look, binding = self._measure(groups)
            least = least or binding
            if not look.failing:
                continue
            if self._hopeless(look):
                return Certificate(False, binding, Suspects(other, look.failing))
            # the one that travels further is divided first
            my_halves, their_halves = mine.halves(), theirs.halves()
            if my_halves and (my_travel >= their_travel or not their_halves):
                stack += [(half, theirs, look.failing) for half in my_halves]
            elif their_halves:
                stack += [(mine, half, look.failing) for half in their_halves]
            else:
                return Certificate(False, binding, Suspects(other, look.failing))
        return Certificate(True, least)

    def _place(self, robot: str, piece: Piece) -> float:
        span = piece.span()
        return self._proximity.place(robot, span.middle, span.half, span.offsets, span.deviation)

    def _hopeless(self, look: DistanceQuery) -> bool:
        """The budget is spent, or bodies are too near even at the middle, where halving does not help."""
        return self._left < 0 or look.too_near

    def _measure(self, groups: Sequence[Group]) -> tuple[DistanceQuery, Binding | None]:
        """Result of the groups, at least one, at the present placement, and the pair with the least room."""
        self._left -= 1
        look = self._proximity.look(groups, NUMERICAL_TOLERANCE_M)
        return look, None if look.tightest is None else Binding(look.tightest, look.stop_distance_m)


HALVINGS = 5
"""Resolution of the search: 1/32 of the refused scale."""

ROUNDS = 3
"""Searches that end with a certificate; a fourth would hardly find more."""

Holds = Callable[[float, Sequence[Suspects]], bool]
"""Whether suspects keep apart at a scale."""


def largest(
    certify: Callable[[float], Certificate], holds: Holds, refused: float, first: Certificate
) -> float:
    """Largest certified scale that the search finds between 1/32 of a refused one and that one; 0 if none.

    Most of a certificate is spent on pairs of bodies that have room enough. So the search halves the scale for suspects
    alone, those pairs at which a certificate failed, and has a scale certified for all pairs only at its end. If that
    fails at another pair, this is a suspect from then on. In any case the result was certified for all pairs.
    `deltaq_cell.kernel.decision` does the same in machine code; tests compare the two.

    Args:
        certify: certificate of a scale, for all pairs.
        holds: judges suspects alone.
        refused: a scale whose certificate does not hold.
        first: that certificate.
    """
    least = refused / 2**HALVINGS
    suspects: list[Suspects] = []
    certificate = first
    for _ in range(ROUNDS):
        assert certificate.failing is not None  # it does not hold
        suspects.append(certificate.failing)
        scale = _halved(lambda s: holds(s, suspects), least, refused)
        if scale == 0.0:
            return 0.0
        certificate = certify(scale)
        if certificate.holds:
            return scale
        if scale == least:
            return 0.0
        refused = scale
    return least if certify(least).holds else 0.0


def _halved(holds: Callable[[float], bool], least: float, refused: float) -> float:
    """Largest scale that holds, to `least`; 0 if even that does not.

    Where a robot stands right before an obstacle the least is refused, and with it nearly always all others.
    """
    if not holds(least):
        return 0.0
    held, step = least, refused - least
    while step > least:
        step /= 2
        if holds(held + step):
            held += step
    return held
