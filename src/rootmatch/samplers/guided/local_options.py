"""Options of the search by local triples."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.options import Options, option


@dataclass(frozen=True)
class LocalOptions(Options):
    """How local triples are tried; what they find and cost: benchmarks/targets.py."""

    least: int = option(50, least=4)
    """Source points from which it is used. The recorded headset without its normals, 32 points of which 7 to 12 are
    seen, takes twice as long by local triples (`rootmatch benchmark real`, eight scenes: 1.3 against 0.65 s)."""
    crowded: float = option(1.0, above=0.0)
    """`crowding` of the detections from which it is not used: its triples are the vaguest. With 60 points of a surface
    and σ = 2 px, local triples take 9 s and wide ones .2 to .4; with σ = 1 px and a crowding of .6 both take .2 s
    (`rootmatch benchmark blind`, surfaces from seed 1050)."""
    points: tuple[float, ...] = option((4, 6, 8, 12), least=2)
    """Neighbours of a point that triples are taken from, level after level; about as much work goes to each."""
    images: tuple[float, ...] = option((4, 8, 16, 32), least=2)
    """Neighbours of a detection that are taken as images, in each of these levels. Of neighbours among the nearest four
    as many images are the nearest four in seven views of benchmarks/targets.py as of those among eight are the nearest
    eight, for a fifth of the work."""
    solved: int = option(30_000_000, least=1)
    """Image triples after which wide triples are tried, or the search ends with what it has found: some seconds."""
    first_wave: int = option(4, least=1)
    """Triples of the first wave of a level; each has twice those of the one before. Not tuned."""
    largest_wave: int = option(64, least=1)
    """Triples of the largest wave. Not tuned."""
    looked_up: int = option(24, least=1)
    """Neighbours that a triple predicts in the sequential test. Not tuned."""
    visible: float = option(0.4, above=0.0, most=1.0)
    """Fraction of them that is assumed to be detected in the first wave of a level. With 0.6 true triples of the views
    of benchmarks/targets.py that show 15 and 22 points were dropped twice as often; with 0.25 all take half as long
    again."""
    whole: int = option(256, least=4)
    """Source points up to which hypotheses are verified on the whole object at once: it is not much larger then than
    what is near a triple. A round value."""
    verified: int = option(64, least=24)
    """Nearest points on which the hypotheses of a larger object are verified first. Of 2,000 points in
    benchmarks/targets.py true triples then have an evidence of 44 in the median, with 24 points 34, with 160 points 20,
    and with all hardly any."""
    stride: float = option(4.0, above=1.0)
    """Factor on that number from one stage of growth to the next: twice as far. A round value."""
    wide_sets: int = option(16, least=1)
    """Triples of the matches found so far that are solved in each stage, wide ones. Not tuned."""
    leads: int = option(2, least=1)
    """Most local hypotheses beyond chance that grow after each wave. Not tuned."""
    rounds: int = option(6, least=1)
    """Most rounds of growth. A bound that is hardly met; not tuned."""
    growth: float = option(3.0, least=0.0)
    """Evidence that another round has to bring. A round value, not tuned."""
    missed: float = option(0.05, above=0.0, most=1.0)
    """Probability of having missed a pose that explains as much, below which the search ends. By construction."""
