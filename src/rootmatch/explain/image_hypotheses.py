"""A body that may be in an image: its model, and the poses that are proposed for it.

The proposals are the fitted poses of assignments that a search found, assignments about a predicted pose, and poses
that nothing in an image excludes: all poses of few matches, their images under near symmetries of the body, and
look-alikes of other bodies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Integers
from rootmatch.cameras.base import CameraModel
from rootmatch.explain.in_time import final_deadline
from rootmatch.explain.likeness import find_copies, first_exact_copies, symmetry_images, ways_alike
from rootmatch.explain.predicted_poses import pose_knowledge, predicted_mixture
from rootmatch.explain.prior_validation import DOUBT, problem_vertical
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copy_with
from rootmatch.hypergraph.tensor import AffinityTensor, strongest_assignments
from rootmatch.model.competition import KEPT, joint_posterior
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import NO_CHANGE, Evidence
from rootmatch.model.exchanged import add_family_places, mark_exchanged
from rootmatch.model.gathering import gather_assignments
from rootmatch.model.known_density import Known
from rootmatch.model.line_readings import is_turn_loose, propose_line_readings, turn_about_lines
from rootmatch.model.linearised import Linearised
from rootmatch.model.mode_search import HOPELESS, NEGLIGIBLE, find_modes, grow_mode, pool_modes
from rootmatch.model.modes import Modes, empty_modes
from rootmatch.model.pose_density import Broad, Doubted, Gaussian, Mixed
from rootmatch.model.posterior import Posterior
from rootmatch.model.prediction import propose_about_each
from rootmatch.model.proposals import (
    Proposals,
    empty_proposals,
    fit_assignments,
    join_proposals,
    look_alikes,
    propose_few_matched,
    reverse_depths,
    rough_fits,
    solve_minimal_sets,
)
from rootmatch.model.shown_in_part import most_visible
from rootmatch.model.successive_symmetries import compose_symmetries, displacements_within, propose_moved
from rootmatch.problems.pose_fit.reference_point import centre_points, pose_about_point

TWINS = 4
"""A body's first poses whose twins are proposed. A round value."""
HYPEREDGES, GATHERED = 4096, 8
"""Strongest hyper-edges of a sweep, whose poses gather detections, and how many assignments that these lead to are
weighed. Of 217 scenes, 56 are trusted and right, 48 without them (benchmarks/adversary.py, from 1000). Round values."""
SUMMED, LIKELY = 4, 0.5
"""Rounds that sum the changes of modes that competition made the first, and their least probability. Round values."""
NAMED = 16
"""Strongest assignments that a tracker's search named, which are weighed: if nothing is in view, up to 64 take 13 ms.
The same bodies are right with all of them (benchmarks/flights.py, room and drone, 3 flights from 1100 and 1300)."""
MAX_PREDICTED = 8
"""Assignments about the predicted poses of a body that are weighed, but two about each. A round value."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A body that may be in an image, with the poses that were proposed for it by itself."""

    task: MatchingTask
    model: DetectionModel
    modes: Modes

    @classmethod
    def of(cls, task: MatchingTask, assignments: list[Integers], tensor: AffinityTensor | None = None) -> Candidate:
        """The candidate by the assignments that were found, and by the hyper-edges of a sweep."""
        nothing = cls(task, cls.make_model(task), empty_modes(task.rows))
        if tensor is not None:
            assignments = [*assignments, *nothing.gather_from_tensor(tensor)]
        return nothing.with_assignments(assignments) if assignments else nothing

    @staticmethod
    def make_model(task: MatchingTask) -> DetectionModel:
        """The model of a task."""
        return make_detection_model(task)

    def gather_from_tensor(self, tensor: AffinityTensor) -> list[Integers]:
        """Assignments that poses of single hyper-edges gather, of those with the largest weights.

        An assignment of all points that a solver found may hold several inconsistent parts, of which one is the body.
        """
        sets = self.poses_of(strongest_assignments(tensor, self.model.shape, HYPEREDGES))
        return list(gather_assignments(self.model, sets, minimum=self.task.minimal + 1, maximum=GATHERED).assignments)

    def poses_of(self, rows: Integers) -> Proposals:
        """Poses of minimal sets of the assignments (K, n) of hyper-edges, with the matches of these sets alone."""
        return solve_minimal_sets(self.model, rows, rows.shape[1]).alone

    def proposals(self, assignments: Sequence[Integers]) -> Proposals:
        """Assignments with their fitted poses, and all poses of those with few matches."""
        rows = select_determined(self.task, assignments)
        if not len(rows):
            return empty_proposals(self.task.rows)
        return join_proposals([rough_fits(self.model, rows), propose_few_matched(self.model, rows)])

    def fit(self, assignments: Integers) -> tuple[Proposals, Evidence, Linearised]:
        """Assignments (K, n) at the best poses that lead on from these, and their evidence."""
        return fit_assignments(self.model, assignments)

    def twins(self, modes: Modes) -> Proposals:
        """Poses in which the body looks as in its best modes, whether the search met them or not."""
        model, points, first = self.model, self.task.points, Proposals(*modes[:3])
        parts = [reverse_depths(model, first), propose_line_readings(model, first.assignments)]
        if self.task.rig is not None:
            parts.append(turn_about_lines(model, modes))
        parts += [look_alikes(first, model.points, model.points, image[None]) for image in symmetry_images(self.task)]
        further = compose_symmetries(points.source, points.normals)
        images = self.task.sighting_rows(further.image)
        return join_proposals([*parts, propose_moved(first, further, images, model.points.mean(axis=0))])

    def with_assignments(self, assignments: Sequence[Integers], predicted: Proposals | None = None) -> Candidate:
        """The candidate by other assignments, the twins of their best poses, and what a prediction proposes."""
        proposals = self.proposals(assignments) if assignments or predicted is None else predicted
        searched = proposals is not predicted and len(proposals.assignments) > 0
        if predicted is not None and proposals is not predicted:
            proposals = join_proposals([proposals, predicted]) if searched else predicted
        modes = find_modes(self.model, proposals, minimum=-math.inf if searched else -HOPELESS)
        prior, poses = self.model.prior, modes.covariance
        others = searched or (len(poses) > 0 and is_turn_loose(poses[0]))
        if not others and isinstance(prior, Doubted):
            others = len(prior.predictions) > 1 or displacements_within(prior, self.task.points) is not None
        if others:
            modes = self._add_twins(modes, searched)
        return copy_with(self, modes=modes)

    def posed(self, proposals: Proposals) -> Candidate:
        """The candidate by assignments with poses, and the twins of the best ones."""
        return copy_with(self, modes=self._add_twins(find_modes(self.model, proposals)))

    def add_assignments(self, assignments: Sequence[Integers]) -> Candidate:
        """The candidate of one of several bodies by further assignments, without their twins.

        The same if clutter explains all of them better: most searches for a body that is not in view end so.
        """
        proposals = self.proposals(assignments)
        modes = find_modes(self.model, proposals, self.modes, of_several=True, minimum=-NEGLIGIBLE)
        worth = len(proposals.assignments) and (modes.log_mass[:1] > 0.0).any()
        return copy_with(self, modes=modes) if worth else self

    def add_twins(self) -> Candidate:
        """The candidate of one of several bodies with the twins of the best pose that a search found for it."""
        return copy_with(self, modes=self._add_twins(self.modes, maximum=1))

    def _add_twins(self, modes: Modes, searched: bool = True, maximum: int = TWINS) -> Modes:
        """Modes and the twins of the best of them, until none of these is better: stairs may be many steps off."""
        known, best = set[bytes](), -math.inf  # of which twins were proposed
        while len(modes.log_mass) and modes.log_mass[0] > best + NO_CHANGE:
            best = float(modes.log_mass[0])
            first = modes.places(self.model.shape[1], maximum)
            poses = [one.tobytes() for one in first.rotation]
            new = np.array([k for k, one in enumerate(poses) if one not in known], np.int64)
            known.update(poses)
            twins = self.twins(first.take(new)) if searched else propose_predicted_twins(self.task, self.model, modes)
            modes = find_modes(self.model, twins, modes, twins=True) if len(twins.assignments) else modes
        return modes

    def add_modes(self, modes: Modes) -> Candidate:
        """The candidate with the modes of another one of the same body, which were weighed among fewer detections."""
        return copy_with(self, modes=find_modes(self.model, Proposals(*modes[:3]), self.modes, of_several=True))

    def alone(self) -> Posterior:
        """The body's posterior if the image shows no other known body."""
        return weigh_candidates([self])[0]


def weigh_candidates(bodies: Sequence[Candidate]) -> list[Posterior]:
    """The posterior of each of several bodies in one image, look-alikes of the others' poses among their own.

    Of exact copies each may be what any of them may be. A look-alike may be wherever the other is weighed.
    """
    with final_deadline().enforce():
        return _compete(bodies)


def _compete(bodies: Sequence[Candidate]) -> list[Posterior]:
    copies = find_copies([(one.task.points.source, one.model) for one in bodies])
    firsts = first_exact_copies([one.model for one in bodies])
    pools = {
        k: pool_modes([one.modes for one, first in zip(bodies, firsts, strict=True) if first == k])
        for k in dict.fromkeys(firsts)
    }
    models, every = dict[int, DetectionModel](), dict[int, Modes]()
    for k, own in pools.items():
        body, more, others = bodies[k], [], []
        for j, pool in pools.items():
            other = bodies[j]
            if other is body or not len(pool.log_odds):
                continue
            for rows, place in ways_alike(other.task, body.task):
                places = Proposals(*pool.first(KEPT).places(body.model.shape[1], TWINS)[:3])
                more.append(look_alikes(places, other.model.points, body.model.points, rows))
                if place is not None:
                    others.append((place, other.model.prior))
        model = add_family_places(body.model, others)
        if more:
            own = find_modes(model, join_proposals(more), own, of_several=True, minimum=-HOPELESS)
        models[k], every[k] = model, own

    def weigh() -> list[Posterior]:
        own = every
        return joint_posterior([models[k] for k in firsts], [own[k] for k in firsts], copies, firsts)

    told = weigh()
    for _ in range(SUMMED):
        known, is_summed = dict[int, Modes](), True
        for k, modes in every.items():
            known[k] = _sum_first_mode(models[k], modes, told[k])
            is_summed &= known[k] is modes
        if is_summed:
            break
        every = known
        told = weigh()
    return [mark_exchanged(models[k], one) for k, one in zip(firsts, told, strict=True)]


def _sum_first_mode(model: DetectionModel, modes: Modes, told: Posterior) -> Modes:
    """Modes with the sum over the changes of the one that a posterior tells, if it may be believed."""
    first = told.modes
    if not len(told.probabilities) or first.summed[0] or told.probabilities[0] < LIKELY:
        return modes
    same = (modes.rotation == first.rotation[0]).all(axis=(1, 2)) & (modes.position == first.position[0]).all(axis=1)
    return grow_mode(model, modes, int(same.argmax())) if same.any() else modes  # what is left of one has its own pose


def is_search_needless(
    model: DetectionModel, told: Posterior, minimal: int, *, of_several: bool = False, unmet: float = math.inf
) -> bool:
    """Whether a predicted pose explains more than any pose elsewhere could, so that no search is needed.

    A pose elsewhere has at most as many matches as there are unexplained detections, or points that can be seen at
    once, or as one that a search has not met (``unmet``). Each is worth as much as those found, or as one of an
    unexplained detection that fits; a minimal set determines the pose, and is one of many. ``of_several``: each is
    worth only as much as those found, else more bodies wait than are found (benchmarks/flights.py, room, 3 flights from
    1000: 244 right, not 251).
    """
    modes = told.modes
    if not len(modes.log_mass):
        return False
    used = modes.assignments[0][modes.assignments[0] >= 0]
    left, mass = model.shape[1] - len(used), float(modes.log_mass[0])
    maximum, visible = min(left, unmet), float(modes.visible[0].sum())
    if maximum > visible:
        maximum = min(maximum, max(visible, most_visible(model)))
    maximum = max(maximum - minimal, 0.0)
    elsewhere = maximum * max(mass, 0.0) / len(used)
    if maximum > 0.0 and not of_several:
        # of two squared deviations over their variances the mean is two: half of that is 1
        worth = -model.clutter.log_density - model.log_areas - 1.0
        mean = float(worth.sum() - worth[used].sum()) / left
        elsewhere = max(elsewhere, maximum * mean - minimal * math.log(left))
    doubt = model.prior.doubt if isinstance(model.prior, Doubted) else DOUBT
    return mass >= math.log(doubt) + elsewhere


def propose_predicted(model: DetectionModel, narrowed: tuple[int, ...] | None = None) -> Proposals | None:
    """Assignments about each predicted pose, with the poses that they lead to; None if there are none.

    ``narrowed``: see `Rivals`.
    """
    if not isinstance(model.prior, Doubted):
        return None
    predictions = [one for one in model.prior.predictions if isinstance(one, Gaussian)]
    every, parts, others = propose_about_each(model, predictions, narrowed), list[Proposals](), list[Proposals]()
    maximum = max(MAX_PREDICTED // len(every), 2) if every[1:] else MAX_PREDICTED
    for found in every:
        parts += [found.take(slice(maximum))]
        others += [propose_few_matched(model, parts[-1].assignments[:1])]
        if len(model.images) <= 1:  # several cameras tell the depth
            others += [reverse_depths(model, parts[-1].take(slice(1)))]
    return join_proposals([*parts, *others]) if parts else None


def make_detection_model(task: MatchingTask) -> DetectionModel:
    """The model of a task of one body."""
    points, problem, allowed = task.points, task.problem, task.allowed
    centre, _, radius = centre_points(points.source)
    camera: CameraModel
    if task.rig is not None:
        (camera, points), own = task.sightings, task.own_camera
        allowed = own if allowed is None else own & np.tile(allowed, (len(task.rig.views), 1))
        target, sigma = points.target, points.detection_noise
    else:
        camera, target, sigma = problem.camera.chart(points.target, points.detection_noise)  # type: ignore[attr-defined]
    upright, known = problem_vertical(problem), pose_knowledge(task)
    prior: Mixed = Broad(radius) if upright is None else Known(upright, centre, radius)
    if known is not None:
        prior = Doubted([Known(known, centre, radius)], [math.log1p(-DOUBT)], prior, DOUBT)
    if task.prior_pose is not None:
        prior = _add_predictions(task, prior, centre)
    return DetectionModel(
        camera, points.source, target, sigma, normals=points.normals, view_cosine=points.view_cosine,
        source_covariance=points.source_covariance, target_covariance=points.target_covariance,
        rate=task.options.detection_rate, prior=prior,
        calibration_noise=task.calibration_noise, allowed=allowed, log_weights=task.log_weights,
        resolution=task.options.resolution or 0.0,
    )  # fmt: skip


def _add_predictions(task: MatchingTask, without: Mixed, centre: NDArray[np.float64]) -> Doubted:
    """Predicted poses as a prior of the body's centre, beside what is known without them."""
    predictions, shares, doubt = [], [], task.rivals.doubt
    for pose, share in predicted_mixture(task):
        assert pose.covariance is not None
        place, covariance = pose_about_point(pose.R, pose.t, pose.covariance, centre)
        predictions.append(Gaussian(pose.R, place, covariance, freedom=task.prior_freedom))
        shares.append(math.log(max(share, 1e-300)) + math.log1p(-doubt))
    lit = task.rivals.lit
    known = 1.0 if lit is None or len(lit) != task.rows else lit
    return Doubted(predictions, shares, without, doubt, task.rivals.places, lit=known, placed=task.rivals.placed)


def select_determined(task: MatchingTask, assignments: Sequence[Integers]) -> Integers:
    """Those of some assignments (K, n) that have more matches than a minimal set, each once."""
    enough = {one.tobytes(): one for one in assignments if np.count_nonzero(one >= 0) > task.minimal}
    return np.array(list(enough.values()), np.int64).reshape(-1, task.rows)


def propose_predicted_twins(task: MatchingTask, model: DetectionModel, modes: Modes) -> Proposals:
    """Poses about one prediction in which the body looks as in its best modes, which may lie about another.

    A prediction that is off by many degrees may not find what a better one has found, and would lose by that alone. Nor
    does it find how a body is turned about a line on which all matches are.
    """
    best, prior = modes.first(TWINS), model.prior
    first, parts = Proposals(*best[:3]), [turn_about_lines(model, best)]
    if isinstance(prior, Doubted) and len(prior.predictions) > 1:
        for image in symmetry_images(task, (False,)):
            twins = look_alikes(first, model.points, model.points, image[None])
            known = (twins.assignments[:, None] == modes.assignments).all(axis=2).any(axis=1)
            twins = twins.take(~known)
            parts.append(twins.take(prior.prediction_indices(twins.rotation, twins.position) >= 0))
    if isinstance(prior, Doubted) and (motions := displacements_within(prior, task.points)) is not None:
        images = task.sighting_rows(motions.image)
        parts.append(propose_moved(first, motions, images, model.points.mean(axis=0), prior=prior))
    return join_proposals(parts)
