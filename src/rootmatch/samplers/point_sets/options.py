"""How hard to search for the motion between two point sets."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.options import Options, option


@dataclass(frozen=True)
class PointSetOptions(Options):
    """Options of the search between two point sets of one space; see `rootmatch.Guided`.

    Parameters
    ----------
    triples : int
        Most triples of source points that are tried. A round value: three of ten matched points in a hundred are among
        so many with 99.5 %.
    draws : int
        Random triples of which the widest is tried. A round value: fewer are flat, more are all at the rim.
    least : int
        Triples tried at least, however clear the best motion is. A round value.
    missed : float
        Probability at which a motion that explains as many points as the best one may have been missed. A round value.
    gate : float
        Deviation in σ up to which distances within a triple agree. A round value: of 10,000 right ones two are lost.
    wide_gate : float
        Deviation in σ within which a point counts for the motion of a triple, whose own error it covers too. A round
        value, as `GuidedOptions.gate`.
    pairs : int
        Most pairs of targets that are tried for a side; a seeded selection of more. Not tuned.
    refined : int
        Motions of a triple, those that explain the most points, that are refined on these points. Not tuned.
    chance_samples : int
        Random hyper-edges that estimate the mean weight by chance: three constraints agree far more rarely than one.
        Evaluated in some milliseconds; a round value.
    kept : int
        Distinct motions that are kept. Not tuned.
    candidates : int
        Targets that a point may have in each. As elsewhere in the guided search.
    beyond : float
        Evidence by which the best motion has to exceed the logarithm of the motions tried. A round value: e⁻⁵ is 0.7 %.
    """

    triples: int = option(6000, least=1)
    draws: int = option(4, least=1)
    least: int = option(12, least=1)
    missed: float = option(0.005, above=0.0, most=1.0)
    gate: float = option(3.7, above=0.0)
    wide_gate: float = option(8.0, above=0.0)
    pairs: int = option(20_000, least=1)
    refined: int = option(4, least=1)
    chance_samples: int = option(100_000, least=1)
    kept: int = option(20, least=1)
    candidates: int = option(3, least=1)
    beyond: float = option(5.0, least=0.0)
