"""What random samples leave open between two views: two rows of the approximations in docs/two-view-model.md.

Log B and the probabilities of matches, of three runs that differ by their samples alone; and log A, the evidence that
two images of houses show scenes that are alike, by the samples of a match and by --samples in each round.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from unittest.mock import patch

import numpy as np
from scipy.spatial.transform import Rotation
from shared import Floats, head, parser, row

import rootmatch as rm
from rootmatch.explain.sampling import sample
from rootmatch.explain.task import MatchingTask
from rootmatch.explain.two_view_decision import make_two_view_model
from rootmatch.model import two_view_alike
from rootmatch.model.two_view_posterior import TwoViewPosterior, sample_two_view_posterior
from rootmatch.simulation import three_plus_one_scene

CAMERA = rm.Camera(1000.0, 1000.0, 640.0, 480.0)
SIZE = (1280.0, 960.0)
KINDS = [(n, clutter, baseline) for n, clutter in ((6, 3), (10, 5), (20, 10)) for baseline in (0.2, 1.0, 5.0)]
"""Points, clutter and baseline of scenes of ``rootmatch simulate 3p1``, with σ = .5 px."""
RUNS = 3
MAX_PAIRS = 12 * 12


def posteriors(task: MatchingTask, runs: int) -> Iterator[TwoViewPosterior]:
    """What the model tells of a task about what one search names, run by run."""
    model, named = make_two_view_model(task), sample(task).assignments
    assert model is not None
    assert named is not None
    return (sample_two_view_posterior(model, np.asarray(named, np.int64), run) for run in range(runs))


def print_spread(seeds: range) -> None:
    """Print standard deviations over runs: of log B by scene, of the probability of a match or of none by point."""
    evidence: list[float] = []
    probability: list[float] = []
    for n, clutter, baseline in KINDS:
        for seed in seeds:
            scene = three_plus_one_scene(n, clutter, 0.5, seed, baseline)
            told = list(posteriors(MatchingTask.of(scene.problem, scene.source, scene.target, noise=0.5), RUNS))
            evidence.append(float(np.std([one.log_evidence for one in told], ddof=1)))
            probability.extend(np.std([one.confidence_in(scene.truth) for one in told], axis=0, ddof=1))
    head("standard deviation", "number", "median", "90 %", "99 %")
    for name, found in (("of log B", evidence), ("of a probability", probability)):
        row(name, len(found), *(f"{value:.4f}" for value in np.quantile(found, (0.5, 0.9, 0.99))))


def house(rng: np.random.Generator) -> Floats:
    """Windows (12, 3) across the street, each 10 cm off a common grid."""
    x, y = np.meshgrid(2.5 * np.arange(4), 3.0 * np.arange(3))
    return np.column_stack([x.ravel() - x.mean(), y.ravel() - 5.0, np.full(12, 12.0)]) + rng.normal(0.0, 0.1, (12, 3))


def images(same: bool, seed: int) -> MatchingTask:
    """Two images from places 2 m apart, of one house or of two with windows in the same grid."""
    rng = np.random.default_rng(seed)
    first = house(rng)
    second = first if same else house(rng)
    axes, seen = [], []
    for windows, x in ((first, 0.0), (second, 2.0)):
        R = Rotation.from_euler("zx", rng.normal(0.0, (0.03, 0.05))).as_matrix()
        pixels = CAMERA.project((windows - (x, 0.0, 0.0)) @ R.T) + rng.normal(0.0, 0.3, (12, 2))
        seen.append(rng.permutation(pixels[((pixels > 0.0) & (pixels < SIZE)).all(axis=1)]))
        axes.append(tuple(R[:, 1]))
    return MatchingTask.of(rm.ThreePlusOne(CAMERA, axis=axes[0], axis2=axes[1]), *seen, noise=0.3)


def print_alike(seeds: range, samples: int) -> None:
    """Print by how much log A of a match is below that of many samples, where both of them look at it to the end."""
    head("houses", "pairs", "log A too low by", "at worst")
    for same in (False, True):
        below = []
        for seed in seeds:
            task = images(same, seed)
            (few,) = posteriors(task, 1)
            with patch.multiple(two_view_alike, SAMPLES=samples, MAX_RATIOS=samples * MAX_PAIRS):
                (many,) = posteriors(task, 1)
            if math.isfinite(few.likeness[0]) and math.isfinite(many.likeness[0]):
                below.append(many.likeness[0] - few.likeness[0])
        row("one" if same else "different", len(below), f"{np.mean(below):.2f}", f"{max(below):.2f}")


def main() -> None:
    options = parser(__doc__, first_seed=1000, scenes=5, pairs=30, samples=10_000).parse_args()
    first = options.first_seed
    print_spread(range(first, first + options.scenes))
    print()
    print_alike(range(first, first + options.pairs), options.samples)


if __name__ == "__main__":
    main()
