"""Several motions among proposed pairs: few correspondences per point, many of them false, as from a learned matcher.

If each point has only a few candidates, minimal sets are drawn from the existing pairs instead of from all sets of
points with all images, nearly all of which are excluded. Neighbours in space share a motion more often than points
drawn anywhere, so sets are drawn among neighbours. The pose with which most pairs agree is fitted to them, its pairs
are removed, and the next one is sought among the rest (sequential RANSAC; Vincent and Laganière 2001).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import Pace
from rootmatch.explain.image_hypotheses import make_detection_model
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.assignment import one_hot
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.model.proposals import fit_assignments
from rootmatch.problems.limits import GATE
from rootmatch.problems.pose_fit.starts import solve_triples
from rootmatch.samplers.base import SampledTensor
from rootmatch.solvers.base import Solution

KNOWN = ("p3p", "up2p")
"""Problems of one calibrated camera and points in space; the vertical of an upright camera enters only the fits."""


PAIRS_PER_POINT, MIN_PAIRS = 3.0, 60
"""Mean number of candidates per point up to which pairs are enumerated, and number of pairs below which the usual
search is as quick. Round values; what these and those below find: benchmarks/candidates.py."""
NEIGHBOURS = 100
"""Pairs nearest in space to the first one of a set, among which the others are drawn. A round value."""
SETS = 4_000
"""Minimal sets drawn for each motion: where a tenth of the neighbours agrees, one is missed in 50 searches; where a
fifth does, none. A round value."""
SCREENED, VERIFIED = 400, 64
"""Pairs on which all poses are screened, and poses, those of the most such pairs, that are verified on all pairs."""
ROUNDS = 6
"""Fits of a pose to the pairs that agree with it, at most."""
CLAIMED = 3.0
"""Distance from a pose, in gates, within which its pairs are no evidence for another motion."""
BEYOND_CHANCE = 7.0
"""Evidence above the logarithm of the number of poses from which a motion is no accident: one in a thousand."""
EDGES = 2_000
"""Hyper-edges of each motion that the tensor holds, as a sample."""


def is_worth_drawing(task: MatchingTask) -> bool:
    """Whether several motions are to be found among few proposed pairs."""
    if task.allowed is None or task.problem.name not in KNOWN or task.options.chosen_sampler != "auto":
        return False
    count = int(task.allowed.sum())
    return count >= MIN_PAIRS and count <= PAIRS_PER_POINT * int(task.allowed.any(axis=1).sum())


def find_pair_motions(task: MatchingTask) -> tuple[Solution, SampledTensor]:
    """Groups of one motion each among the candidates, and a tensor of some of their hyper-edges."""
    search = _Search(task)
    maximum = math.inf if task.options.motions == "auto" else float(task.options.motions)
    groups: list[Integers] = []
    evidence: list[float] = []
    while len(groups) < maximum:
        group, value = search.find_next_motion()
        if group is None:
            break
        groups.append(group)
        evidence.append(value)
    labels, assignment = np.full(task.shape[0], -1, np.int64), np.full(task.shape[0], -1, np.int64)
    for label, group in enumerate(groups):
        labels[group >= 0], assignment[group >= 0] = label, group[group >= 0]
    tensor = _sample_hyperedges(task, groups, search.rng)
    statistics = {"evidence": float(sum(evidence)), "lead": 1.0 if evidence else 0.0, "against_chance": 1.0}
    solution = Solution(
        one_hot(assignment, task.shape[1]), assignment, float(tensor.weights.sum()), [],
        converged=not task.deadline.stopped_early, iterations=search.tried, statistics=statistics, groups=labels,
    )  # fmt: skip
    return solution, SampledTensor(tensor, search.tried)


class _Search:
    """The pairs that are left, and the poses that they propose."""

    def __init__(self, task: MatchingTask) -> None:
        assert task.allowed is not None
        self.task = task
        self.rng = np.random.default_rng(task.options.seed)
        self.source, self.target = np.nonzero(task.allowed)
        problem: Any = task.problem
        points = task.points
        self.camera, pixels, sigma = problem.camera.chart(points.target, points.target_noise)
        self.points, self.pixels, self.sigma = points.source[self.source], pixels[self.target], sigma[self.target]
        self.rays = problem.camera.bearings(points.target)[self.target]
        self.model = make_detection_model(task)
        self.left = np.ones(len(self.source), np.bool_)
        self.tried = 0

    def find_next_motion(self) -> tuple[Integers | None, float]:
        """The assignment (n,) of the motion that most of the pairs left agree with, and its evidence; or None."""
        rows = np.flatnonzero(self.left)
        if len(rows) <= self.task.problem.order or self.task.deadline.passed():
            return None, 0.0
        best, chance = self._best_hypothesis(rows)
        if best is None:
            return None, 0.0
        group, near = self._fit_group(rows, best)
        evidence = self._evidence(int((group >= 0).sum()), len(rows), chance)
        self.left[near] = False
        if (group >= 0).sum() <= self.task.problem.order or evidence <= 0.0:
            return None, 0.0
        self.left &= ~np.isin(self.source, np.flatnonzero(group >= 0)) & ~np.isin(self.target, group[group >= 0])
        return group, evidence

    def _best_hypothesis(self, rows: Integers) -> tuple[tuple[Floats, Floats] | None, float]:
        """The pose of a minimal set that most pairs agree with, and the share that agrees with any."""
        from scipy.spatial import cKDTree  # slow to import

        _, near = cKDTree(self.points[rows]).query(self.points[rows], min(NEIGHBOURS, len(rows)))
        screened = self.rng.permutation(rows)[:SCREENED]
        kept_r, kept_t, kept_count, shares = [], [], [], []
        pace, done = Pace(self.task.deadline.part(0.5), 64), 0
        while done < SETS and (few := pace.block(min(500, SETS - done))):
            done += few
            first = self.rng.integers(0, len(rows), few)
            others = near[first[:, None], self.rng.integers(0, near.shape[1], (few, 2))]
            triple = rows[np.column_stack([first, others])]
            i, j = np.sort(self.source[triple], axis=1), np.sort(self.target[triple], axis=1)
            triple = triple[((np.diff(i) > 0) & (np.diff(j) > 0)).all(axis=1)]
            if not len(triple):
                continue
            rotation, t = solve_triples(self.points[triple], self.rays[triple])
            rotation, t = rotation.reshape(-1, 3, 3), t.reshape(-1, 3)
            real = np.isfinite(t).all(axis=1)
            rotation, t = rotation[real], t[real]
            self.tried += len(t)
            count = self._select_agreeing(rotation, t, screened).sum(axis=1)
            strongest = np.argsort(-count, kind="stable")[:VERIFIED]
            kept_r.append(rotation[strongest])
            kept_t.append(t[strongest])
            kept_count.append(count[strongest])
            shares.append(float(np.median(count)) / len(screened))
        if not kept_r:
            return None, 1.0
        rotation, t, count = np.concatenate(kept_r), np.concatenate(kept_t), np.concatenate(kept_count)
        strongest = np.argsort(-count, kind="stable")[:VERIFIED]
        rotation, t = rotation[strongest], t[strongest]
        agree = self._select_agreeing(rotation, t, rows)
        best = int(np.argmax([len(np.unique(self.target[rows[one]])) for one in agree]))
        return (rotation[best], t[best]), max(float(np.mean(shares)), 1.0 / len(rows))

    def _select_agreeing(self, rotation: Floats, t: Floats, rows: Integers) -> Bools:
        """Which pairs (R,) lie within the gate of each pose: (K, R)."""
        with np.errstate(all="ignore"):
            placed = self.points[rows] @ rotation.swapaxes(-1, -2) + t[:, None]
            squared = ((self.camera.project(placed) - self.pixels[rows]) ** 2).sum(axis=-1)
        return np.asarray((placed[..., 2] > 0.0) & (squared <= (GATE * self.sigma[rows]) ** 2))

    def _fit_group(self, rows: Integers, pose: tuple[Floats, Floats]) -> tuple[Integers, Integers]:
        """The assignment that agrees with a pose fitted to it, and all pairs near it."""
        rotation, t = pose
        with np.errstate(all="ignore"):
            placed = self.points[rows] @ rotation.T + t
            distance = np.linalg.norm(self.camera.project(placed) - self.pixels[rows], axis=1) / self.sigma[rows]
        distance[~(placed[:, 2] > 0.0)] = np.inf
        group = self._match_one_to_one(rows, distance)
        for _ in range(ROUNDS):
            if (group >= 0).sum() <= self.task.problem.order:
                break
            _, _, at = fit_assignments(self.model, group[None])
            if not len(at.pixels):
                break
            offset = at.pixels[0][self.source[rows]] - self.pixels[rows]
            distance = np.linalg.norm(offset, axis=1) / self.sigma[rows]
            before, group = group, self._match_one_to_one(rows, distance)
            if np.array_equal(before, group):
                break
        return group, rows[distance <= CLAIMED * GATE]

    def _match_one_to_one(self, rows: Integers, distance: Floats) -> Integers:
        """The assignment (n,) of pairs within the gate, the nearest first, each point and detection once."""
        group, used = np.full(self.task.shape[0], -1, np.int64), np.zeros(self.task.shape[1], np.bool_)
        for number in np.argsort(distance, kind="stable"):
            if not distance[number] <= GATE:
                break
            i, j = self.source[rows[number]], self.target[rows[number]]
            if group[i] < 0 and not used[j]:
                group[i], used[j] = j, True
        return group

    def _evidence(self, agreeing: int, pairs: int, chance: float) -> float:
        """Log-odds of so many pairs agreeing with a pose, against chance and the number of trials.

        A bound of the binomial tail (Chernoff 1952).
        """
        share = min(agreeing / pairs, 1.0 - 1e-12)
        if share <= chance:
            return -math.inf
        tail = share * math.log(share / chance) + (1.0 - share) * math.log((1.0 - share) / max(1.0 - chance, 1e-12))
        return pairs * tail - math.log(max(self.tried, 1)) - BEYOND_CHANCE


def _sample_hyperedges(task: MatchingTask, groups: list[Integers], rng: np.random.Generator) -> AffinityTensor:
    """Random hyper-edges within each group, with their weights."""
    from rootmatch.backends import cpu
    from rootmatch.hypergraph.random_tuples import permuted_tuples

    indices, weights = [np.empty((0, task.problem.order), np.int32)], [np.empty(0)]
    kind, tables = task.affinity.residual.kernel_kind(task.problem.pair_count), task.problem.tables(task.points)
    for group in groups:
        members = np.flatnonzero(group >= 0)
        source = members[np.sort(permuted_tuples(rng, EDGES, len(members), task.problem.order), axis=1)]
        residuals = cpu.residuals(tables, kind, source, group[source])
        keep = residuals <= task.affinity.gate
        indices.append((source[keep] * task.shape[1] + group[source[keep]]).astype(np.int32))
        weights.append(task.affinity.weights(residuals[keep]))
    tensor = AffinityTensor.unchecked(
        np.ascontiguousarray(np.concatenate(indices)), np.concatenate(weights), task.shape, task.weights
    )
    return tensor.merged() if tensor.size else tensor
