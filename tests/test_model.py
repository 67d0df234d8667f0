"""The model of a body's image: its integrals against sampling, its priors, clutter, and bodies that compete."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import gammaln, logsumexp

from oracles import log_first
from rootmatch.cameras.pinhole import Camera
from rootmatch.cameras.rig import Rig
from rootmatch.cameras.rig_image import RigImage
from rootmatch.model.clutter import estimate_clutter
from rootmatch.model.competition import joint_posterior
from rootmatch.model.compiled.evidence import log_crowd_correction, log_student_density
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import settle_evidence, weigh_assignments, weigh_poses
from rootmatch.model.known_density import Known
from rootmatch.model.mode_search import find_modes
from rootmatch.model.modes import Modes, empty_changes_each
from rootmatch.model.pose_density import ANY_TURN, Broad, Gaussian, PoseDensity
from rootmatch.model.posterior import Posterior
from rootmatch.model.priors import COPY, DEPTHS, PRESENT_ODDS
from rootmatch.model.proposals import Proposals, look_alikes, propose_few_matched
from rootmatch.problems.pose_fit.pose_prior import PosePrior

Floats = NDArray[np.float64]
CAMERA = Camera(900.0, 900.0, 640.0, 480.0)
SIGMA, VIEW = 0.4, math.cos(math.radians(70.0))


def made(
    seed: int, count: int = 5, clutter: int = 4, normals: bool = True, hidden: int = 0
) -> tuple[DetectionModel, Floats, Floats, NDArray[np.int64]]:
    """A small body before `CAMERA`: model, rotation, position of its centre and the true assignment."""
    rng = np.random.default_rng([seed, count, clutter])
    points = rng.uniform(-0.06, 0.06, (count, 3))
    R = Rotation.random(random_state=rng).as_matrix()
    position = np.array([rng.uniform(-0.2, 0.2), rng.uniform(-0.1, 0.1), rng.uniform(0.5, 1.0)])
    places = (points - points.mean(axis=0)) @ R.T + position
    pixels = places[:, :2] / places[:, 2:] * 900.0 + (640.0, 480.0)
    shown = count - hidden
    target = np.concatenate([pixels[:shown], rng.uniform((0, 0), (1280, 960), (clutter, 2))])
    target += rng.normal(0.0, SIGMA, target.shape)
    towards = -places / np.linalg.norm(places, axis=1, keepdims=True) @ R
    facing = towards + 0.5 * rng.normal(size=towards.shape)
    cosine = (facing * towards).sum(axis=1, keepdims=True) / np.linalg.norm(facing, axis=1, keepdims=True)
    facing = np.where(cosine > VIEW, facing, towards)  # what is seen faces the camera
    model = DetectionModel(
        CAMERA, points, target, np.full(len(target), SIGMA), facing if normals else None,
        np.full(count, VIEW) if normals else None,
    )  # fmt: skip
    assignment = np.where(np.arange(count) < shown, np.arange(count), -1)
    return model, R, position, assignment


def best(model: DetectionModel, R: Floats, position: Floats, assignment: NDArray[np.int64]):  # type: ignore[no-untyped-def]
    """Evidence of one hypothesis at its best pose, with that pose."""
    found, at = weigh_poses(model, assignment[None], R[None], position[None])
    for _ in range(3):
        found, at = settle_evidence(model, assignment[None], found, at)
    return found, at.rotation[0], at.position[0]


def posterior(model: DetectionModel, proposals: Proposals) -> Posterior:
    """That of one body alone."""
    return joint_posterior([model], [find_modes(model, proposals)])[0]


Prior = Callable[[Floats, Floats], Floats]


def anywhere(place: Floats) -> Floats:
    """Logarithm of the broad density of positions (K, 3)."""
    distance = np.linalg.norm(place, axis=1)
    return np.asarray(-np.log(2.0 * distance**3 * math.log(100.0)))


def broad(rotation: Floats, place: Floats) -> Floats:
    """The same of poses."""
    return anywhere(place) - math.log(8.0 * math.pi**2)


class Sampled:
    """log B by importance sampling over poses, with its own projection, visibility, and quadratures."""

    def __init__(self, model: DetectionModel, seed: int = 0, draws: int = 5_000) -> None:
        self.model, self.rng, self.draws = model, np.random.default_rng(seed), draws

    def log_odds(
        self, R: Floats, position: Floats, covariance: Floats, assignment: NDArray[np.int64], prior: Prior = broad
    ) -> float:
        """Under a prior, about a mode: Student's t with four degrees of freedom, 1.3 times as wide."""
        root, freedom = np.linalg.cholesky(1.7 * covariance), 4.0
        z = self.rng.standard_normal((self.draws, 6)) * np.sqrt(freedom / self.rng.chisquare(freedom, (self.draws, 1)))
        step = z @ root.T
        log_q = (
            gammaln(5.0) - gammaln(2.0) - 3.0 * math.log(freedom * math.pi) - np.log(np.diag(root)).sum()
            - 5.0 * np.log1p((z**2).sum(axis=1) / freedom)
        )  # fmt: skip
        angle = np.maximum(np.linalg.norm(step[:, :3], axis=1), 1e-12)
        log_haar = np.log(2.0 * (1.0 - np.cos(angle)) / angle**2)
        rotation = Rotation.from_rotvec(step[:, :3]).as_matrix() @ R
        place = position + step[:, 3:]
        log_prior = prior(rotation, place)
        inside = (angle < math.pi) & (place[:, 2] > 0.0)
        value = np.where(inside, self.likelihood(rotation, place, assignment) + log_prior + log_haar - log_q, -np.inf)
        return float(logsumexp(value) - math.log(self.draws))

    def likelihood(self, rotation: Floats, place: Floats, assignment: NDArray[np.int64]) -> Floats:
        """Logarithm of the likelihood ratio of an assignment, by pose."""
        model, used = self.model, assignment >= 0
        x = np.einsum("kij,nj->kni", rotation, model.points - model.points.mean(axis=0)) + place[:, None]
        pixels = x[..., :2] / x[..., 2:] * 900.0 + (640.0, 480.0)
        squared = (((pixels[:, used] - model.target[assignment[used]]) / SIGMA) ** 2).sum(axis=(1, 2))
        behind = (x[..., 2] <= 0.0)[:, used].any(axis=1)
        k, count = int(used.sum()), len(model.target)
        scale = np.exp(np.linspace(-1.5, 1.5, 31))  # factors on all variances
        weight = 10.0 * math.log(10.0) - gammaln(10.0) - 10.0 * np.log(scale) - 10.0 / scale + math.log(3.0 / 30.0)
        noisy = logsumexp(weight - k * np.log(scale) - 0.5 * squared[:, None] / scale, axis=1)
        density = model.clutter.log_density[assignment[used]]
        first = log_first(model.clutter, np.isin(np.arange(count), assignment[used]))
        clutter = -density.sum() + first + gammaln(count - k + 0.5) - gammaln(count + 0.5)
        visible = np.ones(x.shape[:2])
        if model.normals is not None:
            normal = np.einsum("kij,nj->kni", rotation, model.normals)
            cosine = -(normal * x).sum(axis=2) / np.linalg.norm(normal, axis=2) / np.linalg.norm(x, axis=2)
            visible = 0.02 + 0.98 / (1.0 + np.exp(-1.702 * (cosine - VIEW) / 0.03))
        rate = (np.arange(100) + 0.5) / 100.0
        beta = (9.0 if model.normals is not None else 1.0), 1.0
        log_beta = math.log(beta[0]) + (beta[0] - 1.0) * np.log(rate) - math.log(100.0)  # midpoints
        each = [
            np.log(rate[None] * visible[:, i, None]) if used[i] else np.log1p(-rate[None] * visible[:, i, None])
            for i in range(len(used))
        ]
        shown = logsumexp(sum(each) + log_beta, axis=1)
        shown += math.log(0.9)  # nothing hides a part: at most one point is missing here
        total = noisy + shown + clutter - k * math.log(2.0 * math.pi * SIGMA**2)
        return np.asarray(np.where(behind, -np.inf, total))


@pytest.mark.parametrize(
    ("count", "normals", "maximum"), [(4, True, 0.9), (5, True, 0.6), (5, False, 0.4), (8, False, 0.3)]
)
def test_laplace_is_near_the_integral_over_poses(count: int, normals: bool, maximum: float) -> None:
    errors = []
    for seed in range(1000, 1004):
        model, R, position, assignment = made(seed, count, normals=normals)
        found, R, position = best(model, R, position, assignment)
        exact = Sampled(model).log_odds(R, position, found.covariance[0], assignment)
        errors.append(float(found.log_odds[0]) - exact)
    assert np.abs(errors).max() < maximum, errors
    assert abs(np.median(errors)) < 0.5 * maximum, errors


TURN, MOVE = 0.01, 0.002
"""Standard deviations of predictions, radians and metres."""


def of_prediction(kind: str, R: Floats, position: Floats) -> tuple[PoseDensity, Prior]:
    """A prior of the model and its density written down anew."""
    down = np.array([0.0, 1.0, 0.0])

    def turned(rotation: Floats) -> Floats:
        angle = np.linalg.norm(Rotation.from_matrix(rotation @ R.T).as_rotvec(), axis=1)
        return np.asarray(-0.5 * (angle / TURN) ** 2 - 1.5 * math.log(2.0 * math.pi * TURN**2))

    def moved(place: Floats) -> Floats:
        squared = ((place - position - 0.001) ** 2).sum(axis=1)
        return np.asarray(-0.5 * squared / MOVE**2 - 1.5 * math.log(2.0 * math.pi * MOVE**2))

    def upright(rotation: Floats) -> Floats:
        off = ((rotation @ (R.T @ down) - down) ** 2).sum(axis=1)
        return np.asarray(-0.5 * off / TURN**2 - math.log(2.0 * math.pi * TURN**2 * 2.0 * math.pi))

    any_turn = -math.log(8.0 * math.pi**2)
    variances = np.repeat([TURN**2, MOVE**2], 3)
    if kind == "vertical":
        prior = Known(PosePrior(vertical=(R.T @ down, down, TURN)), np.zeros(3))
        return prior, lambda rotation, place: upright(rotation) + anywhere(place)
    if kind == "rotation":
        prior = Known(PosePrior(rotation=(R, TURN)), np.zeros(3))
        return prior, lambda rotation, place: turned(rotation) + anywhere(place)
    if kind == "position":
        prior = Known(PosePrior(position=(position + 0.001, MOVE)), np.zeros(3))
        return prior, lambda rotation, place: moved(place) + any_turn
    if kind == "origin":
        arm = np.array([0.02, -0.01, 0.03])  # from the origin, whose place is known, to the centre
        prior = Known(PosePrior(position=(position + 0.001 - R @ arm, MOVE)), arm)
        return prior, lambda rotation, place: moved(place - rotation @ arm + R @ arm) + any_turn
    return Gaussian(R, position + 0.001, np.diag(variances)), lambda rotation, place: turned(rotation) + moved(place)


@pytest.mark.parametrize("kind", ["pose", "rotation", "position", "origin", "vertical"])
def test_laplace_is_near_the_integral_under_a_prediction(kind: str) -> None:
    model, R, position, assignment = made(1003, 5, normals=False, hidden=1)
    prior, density = of_prediction(kind, R, position)
    model = DetectionModel(CAMERA, model.points, model.target, model.sigma, prior=prior)
    found, R, position = best(model, R, position, assignment)
    exact = Sampled(model).log_odds(R, position, found.covariance[0], assignment, density)
    assert float(found.log_odds[0]) == pytest.approx(exact, abs=0.4)


@pytest.mark.parametrize(
    "prior",
    [
        Broad(),
        Known(PosePrior(vertical=((0.0, 1.0, 0.0), (0.1, 2.0, 0.0), 0.01)), np.zeros(3)),
        Gaussian(np.eye(3), np.array([0.0, 0.0, 1.0]), 1e-4 * np.eye(6)),
        Known(PosePrior(rotation=(np.eye(3), 1.0)), np.zeros(3)),
        Known(PosePrior(position=((0.0, 0.0, 1.0), 0.3)), np.array([0.1, 0.2, 0.0])),
        Known(PosePrior(rotation=(np.eye(3), 0.1), vertical=((0, 1, 0), (0, 1, 0), 0.05)), np.zeros(3)),
    ],
)
def test_a_prior_alone_is_a_density(prior: PoseDensity) -> None:
    model, _, _, _ = made(1000, 5, normals=False)
    model = DetectionModel(CAMERA, model.points, model.target, model.sigma, prior=prior, rate=0.5)
    nothing = np.full((1, 5), -1)
    found, _ = settle_evidence(
        model, nothing, *weigh_poses(model, nothing, np.eye(3)[None], np.array([[0.0, 0.0, 1.0]]))
    )
    away = np.sort(np.linalg.norm(model.points - model.points.mean(axis=0) + (0.0, 0.0, 1.0), axis=1))
    whole = math.log(DEPTHS)
    places = (np.arange(4000) + 0.5) / 4000 * whole  # of a limit of distance, by the logarithm
    within = 1.0 / (1.0 + (away / (away[0] * np.exp(places)[:, None])) ** 16)
    missed = float(((1.0 - 0.5 * within).prod(axis=1) * 2.0 * (whole - places) / whole / 4000).sum())
    one_by_one, all_hidden = 0.9 * missed, 0.05 / 8.0 / 5.0
    # where a position is known to a third of the distance, any place is not the same within σ
    close = 0.15 if isinstance(prior, Known) and prior.prior.position is not None else 0.02
    assert found.log_odds[0] == pytest.approx(math.log(one_by_one + all_hidden), abs=close)


def test_a_step_leads_to_the_best_pose_and_no_pose_need_be_fitted() -> None:
    model, R, position, assignment = made(1001, 8, normals=False)
    found, R1, position1 = best(model, R, position, assignment)
    again = weigh_assignments(model, assignment[None], model.linearise_about(R1[None], position1[None]))
    near = weigh_assignments(model, assignment[None], model.linearise_about(R[None], position[None]))
    assert (
        np.abs(again.step / np.sqrt(np.diagonal(again.covariance, axis1=1, axis2=2))).max() < 2e-2
    )  # what is left of Q: NO_CHANGE
    assert near.log_odds[0] == pytest.approx(found.log_odds[0], abs=0.05)


def test_hypotheses_are_weighed_side_by_side_as_alone() -> None:
    model, R, position, assignment = made(1002, 6)
    many = np.array([assignment, np.roll(assignment, 1), np.where(assignment == 2, -1, assignment)])
    at = model.linearise_about(np.repeat(R[None], 3, axis=0), np.repeat(position[None], 3, axis=0))
    together = weigh_assignments(model, many, at)
    for k in range(3):
        alone = weigh_assignments(model, many[[k]], at.take(np.array([k])))
        assert together.log_odds[k] == pytest.approx(alone.log_odds[0], rel=1e-12)
        np.testing.assert_allclose(together.covariance[k], alone.covariance[0], rtol=1e-9)


def test_a_point_behind_the_camera_is_no_hypothesis() -> None:
    model, R, position, assignment = made(1002, 6)
    at = model.linearise_about(R[None], -position[None])
    assert weigh_assignments(model, assignment[None], at).log_odds[0] == -np.inf


def test_noise_of_model_points_is_that_of_their_images() -> None:
    model, R, position, assignment = made(1004, 6, normals=False)
    spread = 0.0005
    uncertain = DetectionModel(
        CAMERA, model.points, model.target, model.sigma,
        source_covariance=np.broadcast_to(spread**2 * np.eye(3), (6, 3, 3)),
    )  # fmt: skip
    wider = math.hypot(SIGMA, 900.0 * spread / position[2])
    noisy = DetectionModel(CAMERA, model.points, model.target, np.full(len(model.target), wider))
    one, _, _ = best(uncertain, R, position, assignment)
    other, _, _ = best(noisy, R, position, assignment)
    assert one.log_odds[0] == pytest.approx(other.log_odds[0], abs=0.3)
    np.testing.assert_allclose(one.covariance[0], other.covariance[0], rtol=0.3, atol=1e-6)
    sharp, _, _ = best(model, R, position, assignment)
    assert one.covariance[0, 5, 5] > 1.2 * sharp.covariance[0, 5, 5]


def test_noise_stated_too_small_costs_less_with_a_prior_on_its_scale() -> None:
    squared, freedom = 40.0, 10.0
    scale = np.exp(np.linspace(-3.0, 3.0, 4001))
    log_prior = 10.0 * math.log(10.0) - gammaln(10.0) - 10.0 * np.log(scale) - 10.0 / scale
    exact = logsumexp(log_prior - 0.5 * freedom * np.log(scale) - 0.5 * squared / scale) + math.log(6.0 / 4000.0)
    assert log_student_density(squared, freedom, 20.0) == pytest.approx(exact, abs=1e-3)
    assert log_student_density(squared, freedom, math.inf) == -20.0
    assert log_student_density(squared, freedom, 20.0) > -20.0


def test_a_rig_of_one_camera_is_that_camera() -> None:
    model, R, position, assignment = made(1005, 6)
    rig = Rig([(CAMERA, np.eye(3), np.zeros(3))])
    image = RigImage(rig, len(model.points), np.zeros((1, 2)), np.zeros(len(model.target), np.int64))
    one = DetectionModel(image, model.points, model.target, model.sigma, model.normals, model.view_cosine)
    alone = DetectionModel(CAMERA, model.points, model.target, model.sigma, model.normals, model.view_cosine)
    first, _, _ = best(one, R, position, assignment)
    second, _, _ = best(alone, R, position, assignment)
    assert first.log_odds[0] == pytest.approx(second.log_odds[0], abs=1e-6)


def test_uniform_clutter_is_uniform_and_a_crowd_is_denser() -> None:
    rng = np.random.default_rng(3)
    sigma = np.full(40, SIGMA)
    uniform = estimate_clutter(rng.uniform((0, 0), (1280, 960), (40, 2)), sigma, np.array([1280.0 * 960.0]))
    assert abs(np.mean(uniform.log_density) + math.log(1280.0 * 960.0)) < 0.5
    crowd = np.concatenate([rng.uniform(500, 540, (10, 2)), rng.uniform((0, 0), (1280, 960), (30, 2))])
    found = estimate_clutter(crowd, sigma, np.array([1280.0 * 960.0]))
    assert found.log_density[:10].min() > found.log_density[10:].max()
    whole, half = (log_crowd_correction(np.arange(own), np.zeros(40, np.bool_), found.for_kernels) for own in (10, 5))
    assert whole > half + 1.0, "a crowd that is taken whole owes its first member"


def test_crowds_are_found_among_more_detections_than_are_looked_at() -> None:
    rng = np.random.default_rng(1)
    area = np.array([1280.0 * 960.0])
    crowd = np.concatenate([rng.uniform((0, 0), (1280, 960), (600, 2)), rng.normal((300, 200), 4.0, (20, 2))])
    found = estimate_clutter(crowd, np.full(len(crowd), 0.5), area)
    assert found.about.shape == (620, len(found.centres))
    assert len(found.centres) < 620
    each = np.arange(600, 620), np.arange(20)
    crowded, scattered = (log_crowd_correction(own, np.zeros(620, np.bool_), found.for_kernels) for own in each)
    assert crowded > scattered + 1.0


def test_unrelated_points_are_clutter() -> None:
    """The sum of B over all hypotheses has a mean of 1 under clutter alone; here over those of four of four points."""
    total = []
    for seed in range(1000, 1005):
        rng = np.random.default_rng(seed)
        points, target = rng.uniform(-0.06, 0.06, (4, 3)), rng.uniform((0, 0), (1280, 960), (5, 2))
        model = DetectionModel(CAMERA, points, target, np.full(5, SIGMA))
        every = np.array(list(itertools.permutations(range(5), 4)))
        proposed = propose_few_matched(model, every)
        found, _ = settle_evidence(model, proposed.assignments, *weigh_poses(model, *proposed))
        total.append(float(np.exp(found.log_odds[np.isfinite(found.log_odds)]).sum()))
        told = posterior(model, proposed)
        assert told.believe(0.9) is None
        assert told.clutter > 0.1
    assert np.mean(total) < 1.0, total


def test_clutter_creates_no_trust() -> None:
    """The same hypothesis among more and more clutter; each is a mean over images, as chance moves single ones."""
    means = []
    for clutter in (0, 4, 16, 64):
        value = []
        for seed in range(1000, 1016):
            model, R, position, assignment = made(seed, 5, clutter)
            value.append(float(best(model, R, position, assignment)[0].log_odds[0]))
        means.append(np.mean(value))
    assert all(later < before + 0.3 for before, later in itertools.pairwise(means)), means
    assert means[-1] < means[0] - 2.0, means


def of_first(told: Posterior) -> float:
    """Probability of the first mode's assignment."""
    return told.assignment_probability(told.modes.assignments[0])


def test_the_posterior_finds_what_is_there_and_grows_it() -> None:
    model, R, position, assignment = made(1000, 8, normals=False)
    part = assignment.copy()
    part[[1, 4]] = -1
    told = posterior(model, Proposals(part[None], R[None], position[None]))
    np.testing.assert_array_equal(told.modes.assignments[0], assignment)
    assert 0.98 < of_first(told) <= told.confidence.min() + 1e-12 <= 0.999 + 1e-12
    believed = told.believe(0.9)
    assert believed is not None
    np.testing.assert_array_equal(believed.assignment, assignment)
    assert 0.9 <= believed.probability <= told.confidence.min()
    assert believed.known == 8


def test_probability_is_no_larger_than_any_confidence() -> None:
    for seed in range(1000, 1010):
        model, R, position, assignment = made(seed, 6, 12)
        told = posterior(model, Proposals(assignment[None], R[None], position[None]))
        assert of_first(told) <= told.confidence.min() + 1e-12
        assert told.confidence.max() <= 0.999
        assert told.probabilities.sum() + told.clutter == pytest.approx(0.999)


def test_two_detections_for_one_point_are_a_toss_up() -> None:
    model, R, position, assignment = made(1000, 8, normals=False)
    twin = model.target[3] + (0.1, 0.0)
    model = DetectionModel(CAMERA, model.points, np.vstack([model.target, twin]), np.full(len(model.target) + 1, SIGMA))
    told = posterior(model, Proposals(assignment[None], R[None], position[None]))
    assert 0.3 < told.confidence[3] < 0.7
    assert np.delete(told.confidence, 3).min() > 0.9
    believed = told.believe(0.9)
    assert believed is not None
    assert believed.assignment[3] == -1
    assert (np.delete(believed.assignment, 3) >= 0).all()
    assert believed.probability >= 0.9


def test_the_mirror_image_of_a_body_is_proposed_where_it_looks_the_same() -> None:
    model, R, position, assignment = made(1000, 6, normals=False)
    mirrored = model.points * [-1.0, 1.0, 1.0]
    order = np.random.default_rng(0).permutation(6)
    image = np.argsort(order)
    own = Proposals(assignment[None], R[None], position[None])
    found = look_alikes(own, model.points, mirrored[order], image[None])
    assert np.linalg.det(found.rotation[0]) == pytest.approx(1.0)
    np.testing.assert_array_equal(found.assignments[0][image], assignment)
    other = DetectionModel(CAMERA, mirrored[order], model.target, model.sigma)
    pixels = other.linearise_about(found.rotation, found.position).pixels[0][image]
    # weak perspective: a depth reversed moves a pixel by its distance from the line of sight, times 2 Δz / z
    assert np.abs(pixels - model.target[:6]).max() < 30.0


def test_a_copy_moved_along_looks_the_same() -> None:
    model, R, position, assignment = made(1001, 6, normals=False)
    turn = Rotation.from_rotvec([0.3, -0.5, 1.0]).as_matrix()
    copy = model.points @ turn.T + (0.1, 0.0, -0.2)
    found = look_alikes(Proposals(assignment[None], R[None], position[None]), model.points, copy, np.arange(6)[None])
    other = DetectionModel(CAMERA, copy, model.target, model.sigma)
    np.testing.assert_allclose(
        other.linearise_about(found.rotation, found.position).pixels,
        model.linearise_about(R[None], position[None]).pixels,
    )


def test_a_flat_body_is_turned_over_and_not_only_reversed_in_depth() -> None:
    """Both map its points onto each other, but from near or along it only the turned one has the same image."""
    model, R, position, assignment = made(1002, 6, normals=False)
    flat = model.points * (1.0, 1.0, 1e-4)
    own = Proposals(assignment[None], R[None], position[None])
    turned = flat * (1.0, -1.0, 1.0)  # its mirror image
    found = look_alikes(own, flat, turned, np.arange(6)[None])
    assert len(found.assignments) == 2
    image = DetectionModel(CAMERA, flat, model.target, model.sigma).linearise_about(R[None], position[None]).pixels[0]
    other = DetectionModel(CAMERA, turned, model.target, model.sigma)
    off = np.abs(other.linearise_about(found.rotation, found.position).pixels - image).max(axis=(1, 2))
    assert off.max() > 1.0 > 10.0 * off.min()


def test_several_ways_to_look_alike_are_taken_one_by_one() -> None:
    rng = np.random.default_rng(3)
    points, model = rng.normal(size=(7, 3)), made(1002, 7, normals=False)[0]
    rotations = Rotation.random(2, random_state=rng).as_matrix()
    assignments = np.array([rng.permutation(7), rng.permutation(7)])
    proposals = Proposals(assignments, rotations, rng.uniform((-0.1, -0.1, 1.0), (0.1, 0.1, 2.0), (2, 3)))
    ways = np.full((20, 7), -1)
    for way in ways:
        way[[1, 3, 4, 6]] = rng.permutation(7)[:4]
    together = look_alikes(proposals, points, model.points, ways)
    each = [look_alikes(proposals, points, model.points, way[None]) for way in ways]
    for field, values in together._asdict().items():
        np.testing.assert_allclose(values, np.concatenate([getattr(one, field) for one in each]), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(together.rotation), 1.0)


def made_modes(log_odds: list[float], assignments: list[list[int]]) -> Modes:
    """Modes of a body of which only evidence and detections matter, each in a place of its own."""
    count, n = len(log_odds), len(assignments[0])
    value, places = np.array(log_odds), np.arange(count)[:, None] + [0.0, 0.0, 1.0]
    return Modes(
        np.array(assignments), np.repeat(np.eye(3)[None], count, 0), places,
        np.repeat(np.eye(6)[None], count, 0), value, value, np.ones((count, n)), np.zeros(count),
        np.ones((count, n)), np.zeros(count), np.zeros((count, n)), np.ones(count, np.bool_),
        empty_changes_each(count, n),
    )  # fmt: skip


def test_bodies_share_no_detection_as_all_joint_hypotheses_say() -> None:
    target = np.random.default_rng(0).uniform((0, 0), (1280, 960), (8, 2))
    models = [DetectionModel(CAMERA, np.eye(3) * 0.1, target, np.full(8, SIGMA)) for _ in range(2)]
    modes = [made_modes([6.0, 4.0], [[0, 1, 2], [3, 4, 5]]), made_modes([5.0, 1.0], [[2, 1, 0], [5, 6, 7]])]
    told = joint_posterior(models, modes)
    # a mode of each body and of a copy of each, or none, by hand; −1 is none
    weights = {}
    for chosen in itertools.product((-1, 0, 1), repeat=4):
        shown = [(modes[k % 2], mode) for k, mode in enumerate(chosen) if mode >= 0]
        used = np.concatenate([[], *(one.assignments[mode] for one, mode in shown)])
        if len(np.unique(used)) == len(used):
            named, copies = (sum(mode >= 0 for mode in some) for some in (chosen[:2], chosen[2:]))
            prior = named * PRESENT_ODDS + copies * math.log(COPY)
            # clutter is what none of them explains, by Jeffreys' prior of its number
            own = [float(gammaln(8.5 - np.count_nonzero(one.assignments[mode] >= 0))) for one, mode in shown]
            left = float(gammaln(8.5 - len(used))) + (len(own) - 1) * float(gammaln(8.5)) - sum(own)
            weights[chosen] = math.exp(prior + left + sum(one.log_odds[mode] for one, mode in shown))
    total = sum(weights.values())
    for k in range(2):
        for mode in range(2):
            exact = 0.999 * sum(w for pair, w in weights.items() if pair[k] == mode) / total
            (place,) = np.flatnonzero((told[k].modes.assignments == modes[k].assignments[mode]).all(axis=1))
            assert told[k].probabilities[place] == pytest.approx(exact)
    (alone,) = joint_posterior(models[1:], modes[1:])
    assert of_first(alone) > 0.9, "without the other body it is believed"
    assert told[1].probabilities[0] < 0.9


def test_of_a_body_and_its_mirror_image_the_one_in_view_is_believed() -> None:
    model, R, position, assignment = made(1002, 7, normals=False)
    mirrored = DetectionModel(CAMERA, model.points * [-1.0, 1.0, 1.0], model.target, model.sigma)
    own = Proposals(assignment[None], R[None], position[None])
    modes = (
        find_modes(model, own),
        find_modes(mirrored, look_alikes(own, model.points, mirrored.points, np.arange(len(model.points))[None])),
    )
    here, there = joint_posterior([model, mirrored], modes)
    assert of_first(here) > 0.9
    assert of_first(there) < 0.1


def test_a_flat_noise_prior_is_an_option() -> None:
    model, R, position, assignment = made(1000, 8, normals=False)
    exact = DetectionModel(CAMERA, model.points, model.target, model.sigma, noise_freedom=1e9)
    one, _, _ = best(model, R, position, assignment)
    other, _, _ = best(exact, R, position, assignment)
    assert one.log_odds[0] == pytest.approx(other.log_odds[0], abs=2.0)


def test_what_others_leave_of_a_mode_tells_its_own_points() -> None:
    model, R, position, assignment = made(1004, 8, normals=False)
    taken = np.where(np.arange(8) < 3, assignment, -1)  # another body may have three of its detections
    own = find_modes(model, Proposals(assignment[None], R[None], position[None]))
    told = joint_posterior([model, model], [own, own.take(slice(1))._replace(assignments=taken[None])])[0].modes
    parts = (told.assignments >= 0).sum(axis=1) == 5
    assert parts.any()
    found = weigh_assignments(model, told.assignments, model.linearise_about(told.rotation, told.position))
    np.testing.assert_allclose(told.detected[parts], found.detected[parts], atol=1e-9)
    assert (np.abs(told.detected[parts] - own.detected[0]) > 0.5).all()


@pytest.mark.parametrize("spread", [3.0, 1e4, 1e9])
def test_a_vague_prediction_is_bounded_to_all_rotations_without_rounding(spread: float) -> None:
    """It has an inverse, and the position still follows the rotation as it did."""
    rng = np.random.default_rng(5)
    root = rng.normal(size=(6, 6)) * np.array([[spread] * 3 + [2.0 * spread] * 3]).T
    covariance = root @ root.T
    bounded = Gaussian(np.eye(3), np.array([0.0, 0.0, 1.0]), covariance).bounded_covariance
    np.linalg.cholesky(bounded)
    assert bounded == pytest.approx(bounded.T, rel=1e-9)
    assert np.linalg.eigvalsh(bounded[:3, :3]).max() * ANY_TURN == pytest.approx(1.0)
    change = np.linalg.solve(covariance[:3, :3], covariance[:3, 3:])
    assert np.linalg.solve(bounded[:3, :3], bounded[:3, 3:]) == pytest.approx(change, rel=1e-3, abs=1e-3)
