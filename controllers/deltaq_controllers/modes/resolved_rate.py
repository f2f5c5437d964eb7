"""Joint displacements from hand displacements: a weighted pseudoinverse that is damped where it has to be.

Singular values are made comparable by a length: a turn of 1 rad counts as `LENGTH_M` of travel. Only directions whose
singular value falls below `WEAK` are damped (numerical filtering: Maciejewski & Klein 1988), so that
all other directions stay exact, however near a singularity is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deltaq_protocol.arrays import Array

LENGTH_M = 0.5
"""Travel that a turn of 1 rad counts as [m/rad]."""

WEAK = 0.06
"""Singular value below which a direction is damped [m/rad]."""

DAMPING = 0.04
"""Damping where a direction is lost altogether [m/rad]."""


@dataclass(frozen=True)
class Inverse:
    """A Jacobian's decomposition, to be applied to several displacements.

    Attributes:
        left: (r, m) directions of the hands, as rows, weakest last; turns as travel.
        gains: (r,) damped inverses of the singular values.
        right: (r, n) joint displacements that go with them, as rows.
        values: (r,) singular values [m/rad].
        joint_directions: (r, n) unit right singular vectors, before weighing.
    """

    left: Array
    gains: Array
    right: Array
    values: Array

    @classmethod
    def of(cls, jacobian: Array, inverse_weights: Array | None = None, damping: float = DAMPING) -> Inverse:
        """Decompose a Jacobian.

        Args:
            jacobian: (6 h, n), linear over angular rows for each hand.
            inverse_weights: (n,) diagonal of W^-1; ones if not given.
            damping: of a direction that is lost altogether [m/rad].
        """
        rows = _row_scale(len(jacobian))
        root = np.ones(jacobian.shape[1]) if inverse_weights is None else np.sqrt(inverse_weights)
        u, values, vt = np.linalg.svd(rows[:, None] * jacobian * root, full_matrices=False)
        weakness = np.clip(1.0 - (values / WEAK) ** 2, 0.0, 1.0)
        gains = values / (values**2 + damping**2 * weakness + 1e-12)
        return cls(u.T * rows, gains, vt * root, values)

    def __call__(self, displacement: Array) -> Array:
        """(n,) joint displacement for a displacement of the hands (6 h,) [m, rad]."""
        joints: Array = (self.gains * (self.left @ displacement)) @ self.right
        return joints

    @property
    def weakest(self) -> float:
        """The least singular value [m/rad]; zero if the joints span fewer directions than the hands have."""
        return float(self.values[-1]) if self.left.shape[0] == self.left.shape[1] else 0.0


def _row_scale(rows: int) -> Array:
    return np.tile(np.repeat([1.0, LENGTH_M], 3), rows // 6)
