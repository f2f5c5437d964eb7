"""The search for the largest share of a request that is certified.

Most of a certificate is spent on pairs of bodies that have room enough. So the search halves the scale for suspects
alone, those pairs at which a certificate failed, and has a scale certified for all pairs only at its end. If that
fails at another pair, this is a suspect from then on. Whatever is suspected, what is found was certified in full.
`deltaq_cell.kernel.decision` does the same in machine code; tests hold the one against the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from deltaq_services.sim.certificate import Certificate, Suspects

HALVINGS = 5
"""How finely a scale is searched: 1/32 of what is refused."""

ROUNDS = 3
"""Searches that end with a certificate; a fourth would hardly find what these did not."""

Holds = Callable[[float, Sequence[Suspects]], bool]
"""Whether suspects keep apart at a scale."""


def largest(
    certify: Callable[[float], Certificate], holds: Holds, refused: float, first: Certificate
) -> float:
    """Largest scale found that is certified, from 1/32 of a refused one up to it; 0 if none is found.

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
