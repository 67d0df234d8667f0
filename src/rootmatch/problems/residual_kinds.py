"""The kinds of residual as types, so that the compiler chooses the kernel and nothing is decided in the hot loop.

``pairs`` is a bit mask of the pairs of minimal sets whose polynomials are compared; where several bits are set the
residual is the greatest of theirs. Bit 0 is the pair that the exhaustive sampler uses.
"""

from __future__ import annotations

from typing import NamedTuple


class QR(NamedTuple):
    """``|R_2k,2k|`` of the QR factors of the Sylvester matrix, as in the paper's equation 4."""

    pairs: int = 1


class QRBoth(NamedTuple):
    """The lesser ``|R_2k,2k|`` over the polynomials in x and in 1/x, so that a common root |x| > 1 does no harm."""

    pairs: int = 1


class SVD(NamedTuple):
    """The least singular value of the Sylvester matrix, the paper's other choice."""

    pairs: int = 1


class Normalised(NamedTuple):
    """One resultant over its first-order standard deviation: follows |N(0, 1)| for a true hyper-edge."""

    pairs: int = 1


class Joint(NamedTuple):
    """All constraints of the hyper-edge at once: the square root of a χ²."""

    pairs: int = 1


Kind = QR | QRBoth | SVD | Normalised | Joint
