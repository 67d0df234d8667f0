"""The search for the relative pose of two views: minimal sets until several of them lead to the same assignment.

And until no other pose that explains as many points can well have been missed.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from rootmatch.algebra.rotation import rotation_from_vector
from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import NEVER, Deadline, OutOfTime, checkpoint
from rootmatch.hypergraph.assignment import maximise_total
from rootmatch.jit.threads import LONGEST, run_in_threads, worthwhile_threads
from rootmatch.problems.points import TwoViews
from rootmatch.samplers.base import SamplingTask
from rootmatch.samplers.guided.crowding import uniform_density
from rootmatch.samplers.guided.hypotheses import HypothesisClusters
from rootmatch.samplers.two_views.covering_sets import CoveringSets
from rootmatch.samplers.two_views.image_pieces import run_image_pieces
from rootmatch.samplers.two_views.minimal_poses import FIELDS, ROOTS
from rootmatch.samplers.two_views.pose_refinement import DIMENSIONS, refine_poses
from rootmatch.samplers.two_views.relative_hypothesis import OTHER, SAME, RelativeHypothesis
from rootmatch.samplers.two_views.set_kernels import search_pairs, search_triples

BLURS = (2.25, 1.0, 0.5, 0.25, 0.1)
"""Variance that the pose's error adds in the steps of a refinement, in those of the noise."""
SOLVED = 0.6
"""Share of the time left at a deadline for the minimal sets of a wave, or more: what is found is to be refined."""
SECONDS_PER_POSE = 3e-7
"""To judge the poses of one image of a minimal set, for each detection: a tenth where no pose has it."""
WORTH_A_THREAD = 0.005
"""Such seconds that are worth waking a thread for: they are more than a piece takes. Changes no result."""
SECONDS_PER_RATIO = 2e-7
"""Time to compute one likelihood ratio in a step of a refinement."""
REFINED = 4_000_000
"""Likelihood ratios of the poses that are refined together: 32 MB."""
TILTED = 2
"""Time with tilts over that without. A round value."""
SHRINKS = 4.0
"""Factor between what a pose's error adds in one step and in the next, where there are tilts."""
RARE = 0.1
"""Ratio to the likeliest detection of a point from which another one is a candidate too."""

FIRST_WAVE, WAVE = 3, 2
"""Minimal sets of source points that are tried before the first look at what was found, and before each further one.
Accuracy and time with these and the following numbers are those of benchmarks/two_views.py."""
MAX_SETS, TILTED_SETS = 64, 160
"""Most minimal sets of source points that are tried, and where the common direction was measured."""
BUDGET = 4_000_000
"""Most minimal sets with images that are solved."""
AGREEING = 3
"""Minimal sets that must have led to the likeliest assignment before the search ends."""
MISSED, RIVALLED = 0.1, 0.02
"""Probability of having missed a pose that explains as many points, above which the search does not end: as in
`rootmatch.model.two_view_posterior`, and where two poses are no accident. The scene looks like itself then, and a third
pose may be the right one. Round values."""
REPEATED = 1e-3
"""Odds that a scene looks like itself before it is seen. A stated value: `rootmatch.model.priors.COPY`, of bodies."""
POSES, POSES_REFINED, TILTED_REFINED = 64, 16, 8
"""Poses of a minimal set that are kept, and the likeliest of them, which are refined on all points; with tilts."""
ASSIGNMENTS = 12
"""Assignments that are handed on, to be fitted by a pose each."""
CLUSTERS, CANDIDATES = 4, 3
"""The likeliest of them whose hyper-edges are evaluated, and the detections of a source point that take part."""
VISIBLE = 0.8
"""Probability that a source point is detected."""
REJECT, DRIFT = -4.0, 0.3
"""Log-likelihood ratio at which the sequential test rejects a pose, less so much for each point that was looked at:
among dense clutter a point of the right pose is worth less than nothing now and then. Of the true poses of 50 + 25
points (b = 5, σ = 1) nine tenths stay above both."""
FITS = 6.0
"""Deviation, in σ, within which the correspondences of a minimal set fit their own pose."""
SPREAD = 6.0
"""Largest ratio of the inverse distances of a minimal set: of one order of magnitude."""
SET_BLUR = 1.5
"""Deviation, in σ, that the error of a minimal set's pose adds."""
UNABSORBED = 0.15**2
"""Part of the variance of tilts that still counts as noise when a minimal set's pose is judged:
the pose takes up most of a tilt. With all of it, accidental poses fit as well as the right one."""
TAKEN = math.radians(0.5)
"""Most σ of the tilts for which a minimal set's pose is judged, and with which its refinement begins: with 1.3 and
2.8° 26 and 11 of 40 sets at the right tilts lead to the pose, with .5° 34 (axis noise 2°)."""
BREADTH = math.pi / math.sqrt(48.0)
"""Standard deviation of the logarithm of the inverse distances: that of their log-logistic density."""


def _narrow_tilt(views: TwoViews, tilt2: float) -> tuple[TwoViews, float]:
    """Bearings with the part of the tilts' variance that judges minimal sets, and that variance.

    If the bearings alone are noisier, the direction is taken for exact, and its variance for noise of theirs.
    """
    alone = views.source_variance - tilt2
    if tilt2 <= float(np.median(alone) + np.median(views.target_variance)):
        return views, 0.0
    return views._replace(source_variance=alone + UNABSORBED * min(tilt2, TAKEN**2)), tilt2


class PoseSearch:
    """One search and its hypotheses so far, strongest first.

    Parameters
    ----------
    task : SamplingTask
        Of two views.
    deadline : Deadline
    budget : int
        Most minimal sets with images that are solved, but for the first one of source points.
    """

    def __init__(self, task: SamplingTask, deadline: Deadline = NEVER, budget: int = BUDGET) -> None:
        if task.views is None:
            raise ValueError("the task is not of two views")
        self.task, self.deadline = task, deadline
        self.views, self.tilt2 = _narrow_tilt(task.views, float(getattr(task.tables, "tilt_variance", np.zeros(1))[0]))
        """Bearings, and the variance of the common direction that a refinement finds; 0 if it is exact or nearly so."""
        self.budget = min(budget, BUDGET)
        self.n, self.n_target = task.shape
        self.rng = np.random.default_rng([task.seed, *task.shape])
        self.minimal = 2 if self.views.planar else 3
        self.noise = float(np.median(self.views.source_variance) + np.median(self.views.target_variance))
        possible = np.ones(task.shape) if task.candidates is None else task.candidates.astype(np.float64)
        detected = VISIBLE * min(1.0, self.n / self.n_target)
        self.judge = (
            1.0 / uniform_density(self.views.target), np.ascontiguousarray(possible), VISIBLE,
            detected, SET_BLUR**2 * self.noise, REJECT, DRIFT,
        )  # fmt: skip
        self.covering = CoveringSets(
            np.ascontiguousarray(self.views.source.T), np.flatnonzero(possible.any(axis=1)), self.minimal, self.rng,
            tilt=math.sqrt(self.tilt2),
        )  # fmt: skip
        self.refined = TILTED_REFINED if self.tilt2 > 0.0 else POSES_REFINED
        self.near = min(self.tilt2, TAKEN**2)
        """Variance of the tilts for which a minimal set's pose is judged, and with which its refinement begins."""
        self.own_noise = self.noise - UNABSORBED * self.near
        self.hypotheses: list[RelativeHypothesis] = []
        self.sets = 0
        self.solved = self.tested = self.evaluated = 0
        self.conclusive = False
        self.cut = False
        """Whether the deadline came in the middle of a wave."""

    def run(self) -> None:
        """Run wave after wave until enough of them agree, all sets were tried, or the budget is spent."""
        for sets, tilts in self.covering.waves(FIRST_WAVE, WAVE):
            # of many images a single set may be more than the budget
            maximum = max((self.budget - self.solved) // self.n_target**self.minimal, 1)
            self._try(sets[:maximum], tilts[:maximum])
            self.conclusive = bool(self.hypotheses)
            if self.task.progress is not None:
                self.task.progress(min(self.solved, self.budget), self.budget)
            if self._has_enough() or self._is_spent():
                return
            if self.tilt2 > 0.0 and self.hypotheses and self.hypotheses[0].evidence > self._beyond_chance():
                self.covering.tell(self.hypotheses[0].tilt)

    @property
    def missed(self) -> float:
        """Probability that another pose explains as many points as the likeliest one, and was never met."""
        if not self.hypotheses:
            return 1.0
        return self._unmet_probability() * (1.0 if self.repeated else REPEATED)

    def _unmet_probability(self) -> float:
        """Probability that a pose which explains as many points as the likeliest one was not met, if there is one."""
        return self.covering.missed(int((self.hypotheses[0].assignment >= 0).sum()))

    def _is_spent(self) -> bool:
        spent = self.sets >= (TILTED_SETS if self.tilt2 > 0.0 else MAX_SETS) or self.solved >= self.budget
        return spent or self.cut or self.deadline.passed()

    def _has_enough(self) -> bool:
        """Whether several sets have led to the likeliest pose, and no other beyond chance can well have been missed."""
        led = {one.minimal_set for one in self.hypotheses if one.shared(self.hypotheses[0]) >= SAME}
        return len(led) >= AGREEING and self._unmet_probability() <= (RIVALLED if self.repeated else MISSED)

    def _chance_evidence(self) -> float:
        """Evidence that one of the poses tested reaches by chance."""
        tilts = max(self.tilt2 / self.own_noise, 1.0)  # that a refinement may tell apart
        return math.log(max(self.tested, 1)) + math.log(tilts)

    def _beyond_chance(self) -> float:
        """Evidence of a pose that is no accident."""
        return self._chance_evidence() - math.log(REPEATED)

    @property
    def repeated(self) -> bool:
        """Whether a pose that has nothing to do with the likeliest one is no accident: the scene looks like itself."""
        enough = self._beyond_chance()
        return any(one.evidence > enough and one.shared(self.hypotheses[0]) <= OTHER for one in self.hypotheses)

    def _try(self, sets: Integers, tilts: Floats) -> None:
        """Try minimal sets with all their images, and refine the likeliest poses of each."""
        count = len(sets)
        orders = self.rng.permuted(np.tile(np.arange(self.n), (count, 1)), axis=1)
        # each of some threads keeps the likeliest poses of its share of the images of all sets
        shares = max(int(numba.get_num_threads()), 1)
        poses = np.zeros((shares, count, POSES, FIELDS))
        evidence = np.full((shares, count, POSES), -np.inf)
        counts = np.zeros((shares, count, 3), np.int64)
        limits = np.array([FITS**2, SPREAD])
        search = search_pairs if self.views.planar else search_triples
        each = SECONDS_PER_POSE * self.n_target
        views = [(self.views, 0, count)]
        if self.tilt2 > 0.0:
            targets = [np.ascontiguousarray(one.T @ self.views.target) for one in tilt_rotations(tilts)]
            views = [(self.views._replace(target=one), index, index + 1) for index, one in enumerate(targets)]

        def piece(begin: int, stop: int) -> None:
            """Some of the images of all sets."""
            threads = worthwhile_threads(min(shares, int(each * (stop - begin) * count / WORTH_A_THREAD)))
            ends = np.linspace(begin, stop, threads + 1).astype(np.int64).tolist()

            def work(start: int, end: int) -> None:
                panel, columns = np.zeros((ROOTS, FIELDS, self.n_target)), np.zeros(self.n_target)
                for share in range(start, end):
                    if ends[share] < ends[share + 1]:
                        for turned, index, last in views:
                            search(
                                turned, self.judge, sets, orders, limits, index, last, ends[share], ends[share + 1],
                                panel, columns, poses[share], evidence[share], counts[share],
                            )  # fmt: skip

            run_in_threads(work, threads, threads)

        try:
            reserve = LONGEST + 2.0 * SECONDS_PER_RATIO * count * self.refined * self.n * self.n_target
            with self.deadline.part(SOLVED, reserve).enforce():
                run_image_pieces(piece, self._images(sets), max(int(LONGEST / each), 1))
            self.covering.add(sets, tilts)
        except OutOfTime:
            self.cut = True
        solved, tested, looked_up = counts.sum(axis=(0, 1)).tolist()
        self.solved += solved
        self.tested += tested
        self.evaluated += solved + looked_up
        every = evidence.swapaxes(0, 1).reshape(count, -1)
        order = np.argsort(-every, axis=1, kind="stable")[:, : self.refined]
        real = np.take_along_axis(every, order, axis=1) > -np.inf
        chosen = np.take_along_axis(poses.swapaxes(0, 1).reshape(count, -1, FIELDS), order[:, :, None], axis=1)[real]
        which = np.broadcast_to(np.arange(count)[:, None], real.shape)[real]
        with self.deadline.within():
            self._take(chosen, tilts[which], self.sets + which)
        self.sets += count

    def _images(self, sets: Integers) -> Integers:
        """First and last + 1 (K, 2) of the images that some of the sets may have, as `search_triples` numbers them.

        What cannot be, as a forbidden match, would cost nothing and tell nothing of the cost of the next ones.
        """
        first, second = (np.asarray((self.judge[1] > 0.0)[sets[:, place]].any(axis=0)) for place in (0, 1))
        possible = first if self.views.planar else (first[:, None] & second).ravel()
        ends = np.flatnonzero(np.diff(np.concatenate([[0], possible.astype(np.int8), [0]])))
        return self.n_target * ends.reshape(-1, 2)

    def _take(self, poses: Floats, tilts: Floats, which: Integers) -> None:
        """Refine poses (K, FIELDS) of minimal sets (K,) with tilts (K, 2), some at a time to bound the memory."""
        more = TILTED if self.tilt2 > 0.0 else 1
        step = max(1, REFINED // (self.n * self.n_target))
        for first in range(0, len(poses), step):
            some = slice(first, first + step)
            checkpoint(more * SECONDS_PER_RATIO * len(poses[some]) * self.n * self.n_target)
            refined = self._refine_ratios(poses[some], tilts[some])
            for ratios, tilt, number in zip(*refined, which[some].tolist(), strict=True):
                checkpoint()
                value, assignment = self._assign_likeliest(ratios)
                if (assignment >= 0).sum() > self.minimal:
                    self.hypotheses.append(RelativeHypothesis(value, assignment, ratios.copy(), number, tilt))
                    self.hypotheses.sort(key=lambda one: -one.evidence)
                    del self.hypotheses[POSES:]

    def _refine_ratios(self, poses: Floats, tilts: Floats) -> tuple[Floats, Floats]:
        """Likelihood ratios (K, n, n') at poses (K, FIELDS) with tilts (K, 2), refined on all points; their tilts."""
        views, blurs, rotated = self.views, np.array(BLURS) * self.noise, poses.copy()
        if self.tilt2 > 0.0:
            views = views._replace(source_variance=views.source_variance - UNABSORBED * self.near)
            last = BLURS[-1] * self.own_noise
            steps = math.ceil(math.log(self.near / last) / math.log(SHRINKS))
            blurs = np.array([*np.geomspace(self.near, last, steps + 1), last])
            rotated[:, 2:5] = (tilt_rotations(tilts) @ poses[:, 2:5, None])[..., 0]
        tilts, ratios = tilts.copy(), np.zeros((len(poses), self.n, self.n_target))

        def work(start: int, end: int) -> None:
            sums, normal, side = np.zeros(self.n + self.n_target), np.zeros((DIMENSIONS,) * 2), np.zeros(DIMENSIONS)
            refine_poses(
                views, self.judge, blurs, BREADTH**2, self.tilt2, start, end, rotated, tilts, ratios,
                sums, np.empty((3, 3)), normal, side,
            )  # fmt: skip

        run_in_threads(work, len(poses), worthwhile_threads(len(poses) // 8))
        return ratios, tilts

    def _assign_likeliest(self, ratios: Floats) -> tuple[float, Integers]:
        """The likeliest assignment (n,) and its log-likelihood ratio against clutter."""
        with np.errstate(divide="ignore"):
            gain = np.maximum(np.log(ratios * (VISIBLE / (1.0 - VISIBLE))), 0.0)
        assignment = maximise_total(gain, 0.0)
        matched = np.flatnonzero(assignment >= 0)
        return self.n * math.log(1.0 - VISIBLE) + float(gain[matched, assignment[matched]].sum()), assignment

    def assignments(self) -> Integers:
        """Assignments (K, n) of the hypotheses, each once, strongest first."""
        return np.array([one.assignment for one in self._distinct(ASSIGNMENTS)], np.int64).reshape(-1, self.n)

    def _distinct(self, maximum: int) -> list[RelativeHypothesis]:
        """The strongest hypotheses of different assignments."""
        first = dict[bytes, RelativeHypothesis]()
        for one in self.hypotheses:
            first.setdefault(one.assignment.tobytes(), one)
        return list(first.values())[:maximum]

    def clusters(self) -> HypothesisClusters:
        """The strongest hypotheses that differ, each with the detections that its points may have."""
        leaders = self._distinct(CLUSTERS)
        width = min(CANDIDATES, self.n_target)
        lists = np.full((len(leaders), self.n, width), -1, np.int64)
        for g, one in enumerate(leaders):
            checkpoint()
            worth = one.ratios.copy()
            matched = np.flatnonzero(one.assignment >= 0)
            worth[matched, one.assignment[matched]] = np.inf
            order = np.argsort(-worth, axis=1, kind="stable")[:, :width]
            enough = np.take_along_axis(one.ratios, order, axis=1) >= np.maximum(
                RARE * one.ratios.max(axis=1, keepdims=True), 1e-300
            )
            enough[matched, 0] = True
            lists[g] = np.where(np.logical_and.accumulate(enough, axis=1), order, -1)
        evidence = np.array([one.evidence for one in leaders])
        return HypothesisClusters(lists, evidence, self._chance_evidence())


def tilt_rotations(tilts: Floats) -> Floats:
    """Rotations (K, 3, 3) by tilts (K, 2) about x and z."""
    return np.asarray(rotation_from_vector(np.stack([tilts[:, 0], np.zeros(len(tilts)), tilts[:, 1]], axis=1)))
