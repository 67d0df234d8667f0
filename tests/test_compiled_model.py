"""Compiled parts of the model of an image, each against a slow computation that shares no code with it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation
from scipy.special import gammaln, logsumexp
from scipy.stats import multivariate_normal

import oracles
import rootmatch as rm
from oracles import log_first
from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.brown import Brown
from rootmatch.cameras.kannala_brandt import KannalaBrandt
from rootmatch.cameras.rig_image import RigImage
from rootmatch.cameras.stereographic import Stereographic
from rootmatch.model.clutter import PSEUDO, SCALES, STEPS
from rootmatch.model.compiled.assigning import assign_likeliest
from rootmatch.model.compiled.crowds import fill_crowd_densities, fit_crowd_shares, fit_crowds
from rootmatch.model.compiled.gating import gate
from rootmatch.model.compiled.occluder import DIRECTIONS, MIN_HIDDEN, OCCLUDED
from rootmatch.model.compiled.rates import log_over_rates
from rootmatch.model.compiled.same_pose import is_same_pose
from rootmatch.model.compiled.single_changes import fill_match_gains
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import step_poses, weigh_assignments, weigh_poses
from rootmatch.model.pose_density import DEPTHS, FIELD, Broad, Doubted, Gaussian, PoseDensity
from rootmatch.model.proposals import propose_few_matched
from rootmatch.model.views import camera_frames, kernel_camera_views
from rootmatch.model.visibility import BARELY, EDGE, EDGES, FULLY, LOGISTIC, SLACK, UNSEEN
from rootmatch.problems.pose_fit.starts import solve_triples, wide_triples

Floats = NDArray[np.float64]

PINHOLE = rm.Camera(900.0, 850.0, 640.0, 480.0)
FISHEYE = replace(PINHOLE, fx=300.0, fy=310.0, lens=KannalaBrandt((0.02, -0.01, 0.003, -0.001)))
BROWN = replace(PINHOLE, lens=Brown((-0.2, 0.05, 0.001, -0.002, 0.01, 0.02, 0.01, 0.001, 0.002, 0.001, -0.001, 0.0005)))
TILTED = replace(PINHOLE, lens=Brown((*BROWN.lens.values, 0.02, -0.01)))  # type: ignore[union-attr]
CHART = Stereographic.about(np.array([[0.0, 0.6, 0.8]]))
SIZES = ((1280.0, 960.0), (640.0, 480.0))


def rig(sizes: object = None) -> RigImage:
    """Two cameras, a fisheye among them, that see six points."""
    turn = Rotation.from_rotvec([0.1, -0.3, 0.05]).as_matrix()
    views = [(PINHOLE, np.eye(3), np.zeros(3)), (FISHEYE, turn, np.array([0.1, 0.02, -0.05]))]
    made = rm.Rig(views, sizes=sizes)  # type: ignore[arg-type]
    camera_of = np.array([0, 0, 0, 0, 0, 1, 1, 1, 1])
    return RigImage(made, 6, np.array([[0.0, 0.0], [1300.0, -20.0]]), camera_of)


def scene(
    camera: CameraModel, seed: int = 1000, poses: int = 7, **more: object
) -> tuple[DetectionModel, Floats, Floats]:
    """A model of six points, or of their sightings, and poses, the last of them with points behind the camera."""
    rng = np.random.default_rng(seed)
    if isinstance(camera, RigImage):
        points = np.tile(np.random.default_rng(3).uniform(-0.06, 0.06, (6, 3)), (len(camera.offsets), 1))
    else:
        points = rng.uniform(-0.06, 0.06, (6, 3))
    n = len(points)
    R = Rotation.random(poses, random_state=seed).as_matrix()
    position = rng.uniform((-0.2, -0.1, 0.4), (0.2, 0.1, 0.9), (poses, 3))
    position[-1] = (0.01, 0.0, 0.02)
    normals = rng.normal(size=(n, 3))
    normals[0] = 0.0
    sigma = rng.uniform(0.3, 0.8, 9)
    target = rng.uniform((0, 0), (1280, 960), (9, 2))
    given: dict[str, object] = {"normals": normals, "view_cosine": rng.uniform(0.2, 0.5, n), **more}
    return DetectionModel(camera, points, target, sigma, **given), R, position  # type: ignore[arg-type]


CAMERAS = {
    "pinhole": PINHOLE, "fisheye": FISHEYE, "brown": BROWN, "chart": CHART, "tilted": TILTED, "rig": rig(),
    "sized": replace(FISHEYE, size=SIZES[0]), "rig with sizes": rig(SIZES),
}  # fmt: skip


@pytest.mark.parametrize("name", CAMERAS)
def test_projection_and_its_derivatives(name: str) -> None:
    camera = CAMERAS[name]
    assert (kernel_camera_views(camera) is None) == (name == "tilted")
    model, R, position = scene(camera)
    at = model.linearise_about(R, position)
    places = (model.points - model.centre) @ R.swapaxes(1, 2) + position[:, None]
    with np.errstate(all="ignore"):
        pixels, seen = camera.project(places), camera.sees(places)
        expected = np.where(seen, camera.in_image(pixels), 0.0)
    np.testing.assert_array_equal(at.seen, seen)
    assert seen.any()
    assert not seen.all() or name == "chart"
    np.testing.assert_allclose(at.pixels[seen], pixels[seen], rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(at.expected, expected, rtol=1e-9, atol=1e-12)
    assert not at.jacobian[~seen].any()
    towards = camera.from_centre(places)
    turned = model.normals @ R.swapaxes(1, 2)  # type: ignore[operator]
    for k, i in zip(*np.nonzero(seen), strict=True):
        length = np.linalg.norm(turned[k, i]) * np.linalg.norm(towards[k, i])
        cosine = -turned[k, i] @ towards[k, i] / length if length else np.nan
        np.testing.assert_allclose(at.cosine[k, i], cosine, rtol=1e-9, atol=1e-12)  # type: ignore[index]
    for axis in range(6):
        step, moved = 1e-6 * np.eye(6)[axis], []
        for sign in (1.0, -1.0):
            turn = Rotation.from_rotvec(sign * step[:3]).as_matrix()
            there = (model.points - model.centre) @ (turn @ R).swapaxes(1, 2) + (position + sign * step[3:])[:, None]
            with np.errstate(all="ignore"):
                moved.append(camera.project(there))
        slope = (moved[0] - moved[1]) / 2e-6
        scale = np.abs(at.jacobian).max(axis=(2, 3))[..., None]
        close = np.abs(at.jacobian[..., axis] - slope) <= 2e-6 * scale + 1e-9
        assert close[seen & (places[..., 2] > 0.1)].all()
    np.testing.assert_array_equal(at.by_position, at.jacobian[..., 3:])


EDGE_COSINES = FULLY * (np.arange(EDGES) + 0.5) / EDGES


def visible(
    cosine: Floats | None, view_cosine: Floats | None, tilt: Floats, edge: float | None = None
) -> Floats | float:
    """Visibility of points by their normals, at most 1; 1 if no normals are known.

    Parameters
    ----------
    cosine : (…, n) array or None
        Of `facing`.
    view_cosine : (n,) array or None
        Cosine of the view angle of each point.
    tilt : (…) array
        Standard deviation of the pose's direction, in radians: it blurs the edge.
    edge : float, optional
        Cosine of the view angle where none is given; the mean over all of them if this is not given either.
    """
    if cosine is None:
        return 1.0
    if view_cosine is None and edge is None:
        return np.mean([visible(cosine, None, tilt, one) for one in EDGE_COSINES], axis=0)
    limit = (0.0 if view_cosine is None else view_cosine) - SLACK
    spread = np.sqrt(1.0 - np.minimum(cosine**2, 1.0)) * tilt[..., None]
    with np.errstate(over="ignore"):
        off = cosine - (edge if view_cosine is None else view_cosine)
        shown = 1.0 / (1.0 + np.exp(-LOGISTIC * off / np.sqrt(EDGE**2 + spread**2)))
        barely = BARELY / (1.0 + np.exp(-LOGISTIC * (cosine - limit) / np.maximum(spread, 1e-6)))
    shown = np.maximum(barely + (1.0 - BARELY) * shown, UNSEEN)
    return np.asarray(np.where(np.isnan(cosine), 1.0, shown))


def log_evidence(model: DetectionModel, assignment: NDArray[np.int64], R: Floats, position: Floats, prior: PoseDensity):  # type: ignore[no-untyped-def]
    """The formula of docs/model.md for one assignment about one pose, one term after another."""
    at, terms = model.linearise_about(R[None], position[None]), prior.terms(R[None], position[None])
    pairs = [(i, int(j)) for i, j in enumerate(assignment) if j >= 0]
    precision, slope, squared = terms.precision[0].copy(), terms.slope[0].copy(), float(terms.squared[0])
    total = 0.0
    for i, j in pairs:
        noise = model.sigma[j] ** 2 * np.eye(2)
        if at.blob_variance is not None:
            noise = noise + at.blob_variance[0, i] * np.eye(2)
        if model.source_covariance is not None:
            by_point = at.by_position[0, i] @ R
            noise = noise + by_point @ model.source_covariance[i] @ by_point.T
        off, J = model.target[j] - at.pixels[0, i], at.jacobian[0, i]
        precision += J.T @ np.linalg.inv(noise) @ J
        slope += J.T @ np.linalg.inv(noise) @ off
        squared += off @ np.linalg.inv(noise) @ off
        total += -math.log(2.0 * math.pi) - 0.5 * math.log(np.linalg.det(noise)) - model.clutter.log_density[j]
        if model.log_weights is not None:
            total += model.log_weights[i, j]
        if model.allowed is not None and not model.allowed[i, j]:
            total = -math.inf
        if not at.seen[0, i]:
            total = -math.inf
    covariance = np.linalg.inv(precision)
    step = covariance @ slope
    squared = max(squared - slope @ step, 0.0)
    freedom = 2.0 * len(pairs) - np.trace(covariance @ (precision - terms.precision[0]))
    tilt = min(math.sqrt(np.trace(covariance[:3, :3]) / 2.0), 1.0)
    cosine = None if at.cosine is None else at.cosine[0]
    unknown = cosine is not None and model.view_cosine is None
    nodes, log_nodes = model.rate_quadrature
    owned = np.isin(np.arange(len(assignment)), [i for i, _ in pairs])
    values, every = [], []
    for edge in EDGE_COSINES.tolist() if unknown else [None]:
        shown = at.expected[0] * visible(cosine, model.view_cosine, np.array(tilt), edge)
        if at.blob is not None:
            first = at.blob[0] == np.arange(len(shown))
            any_of = [
                1.0 - np.prod([1.0 - shown[m] for m in range(len(shown)) if at.blob[0, m] == i])
                for i in range(len(shown))
            ]
            shown = np.where(first, any_of, 1e-9)
        images = len(model.images) or 1
        if not every:
            hiding = [(0.0, np.zeros(len(shown), np.bool_))]
            hiding += [hidden_parts(owned, shown, at.pixels[0], images, window) for window in (False, True)]
        places, share = shares_within(owned, shown, at.jacobian[0])
        with np.errstate(divide="ignore"):
            each = [
                odds + weight + places + np.where(
                    owned, np.log(rate * shown * share), np.log1p(-rate * np.where(out, 0.0, shown) * share)
                ).sum(axis=1)
                for odds, out in hiding
                for rate, weight in zip(nodes, log_nodes, strict=True)
            ]  # fmt: skip
        values.append(float(logsumexp(each)) + images * math.log(1.0 - OCCLUDED))
        every.append(shown)
    detected = float(logsumexp(values)) - math.log(len(values))
    weights = np.exp(np.array(values) - max(values)) if np.isfinite(max(values)) else np.eye(len(values))[0]
    shown = weights @ np.array(every) / weights.sum()
    images = model.images or [np.arange(len(model.target))]
    for own in images:
        left = len(own) - len([j for _, j in pairs if j in own])
        total += gammaln(left + 0.5) - gammaln(len(own) + 0.5)
    total += log_first(model.clutter, np.isin(np.arange(len(model.target)), [j for _, j in pairs]))
    half = 0.5 * model.noise_freedom
    total += gammaln(half + freedom / 2.0) - gammaln(half) - freedom / 2.0 * math.log(half)
    total -= (half + freedom / 2.0) * math.log1p(squared / (2.0 * half))
    total += 3.0 * math.log(2.0 * math.pi) - 0.5 * np.linalg.slogdet(precision)[1] + float(terms.log_density[0])
    return total, detected, step, covariance, squared, freedom, shown


def shares_within(owned: NDArray[np.bool_], shown: Floats, jacobian: Floats) -> tuple[Floats, Floats]:
    """Logarithms (K,) of the probabilities of limits of distance, and the share (K, n) that each leaves of a point."""
    spread = np.linalg.svd(jacobian[..., 3:], compute_uv=False)  # across and along, as a pinhole stretches it
    distance = np.full(len(spread), np.inf)
    np.divide(spread[:, 0], spread[:, 1] ** 2, out=distance, where=spread[:, 1] > 0.0)
    nearest = distance[owned | (shown > FULLY)].min()
    whole, count = math.log(DEPTHS), 2000
    places = (np.arange(count) + 0.5) / count * whole
    ways = 2.0 * (whole - places) / whole**2 * (whole / count)
    powers = np.minimum(distance / (nearest * np.exp(places)[:, None]), 1e6) ** 16
    return np.log(ways), 1.0 / (1.0 + powers)


def direction_apart(owned: NDArray[np.bool_], shown: Floats, pixels: Floats) -> Floats:
    """Fisher's discriminant: from the matches to what is missing, in units of the scatter about both means."""
    weights = np.where(owned, 1.0, shown)
    scatter, means = np.zeros((2, 2)), []
    for of in (owned, ~owned):
        mean = weights[of] @ pixels[of] / max(float(weights[of].sum()), 1.0)
        means.append(mean)
        scatter += (weights[of, None] * (pixels[of] - mean)).T @ (pixels[of] - mean)
    scatter += 1e-6 * np.trace(scatter) * np.eye(2)
    return np.linalg.det(scatter) * np.linalg.pinv(scatter) @ (means[1] - means[0])


def hidden_parts(
    owned: NDArray[np.bool_], shown: Floats, pixels: Floats, images: int, window: bool
) -> tuple[float, NDArray[np.bool_]]:
    """Logarithm of the odds of edges, or windows, about all matches, one in each image, and which points they hide."""
    odds, hidden = -math.inf, np.zeros(len(owned), np.bool_)
    for rows in np.split(np.arange(len(owned)), images):
        choices = []
        angles = np.arange(DIRECTIONS) * 2.0 * math.pi / DIRECTIONS
        sides = [
            *np.column_stack([np.cos(angles), np.sin(angles)]),
            direction_apart(owned[rows], shown[rows], pixels[rows]),
        ]
        for side in sides:
            along = pixels[rows] @ side
            beyond = ~owned[rows] & (along > along[owned[rows]].max(initial=-math.inf))
            choices.append((float(shown[rows][beyond].sum()), beyond))
        maximum, beyond = max(choices, key=lambda one: one[0])
        is_fixed = any(hidden == maximum for hidden, _ in choices[:-1])
        outside = np.logical_or.reduce([one for _, one in choices])
        if maximum <= MIN_HIDDEN or (window and float(shown[rows][outside].sum()) <= maximum):
            continue
        places = float(np.where(owned[rows], 1.0, shown[rows]).sum())
        ways = DIRECTIONS if is_fixed else max(0.5 * places, DIRECTIONS)
        here = -math.log(places**3 / 6.0 if window else ways * places)
        here += math.log(0.5 * OCCLUDED / (1.0 - OCCLUDED))
        odds, hidden[rows] = (here if odds == -math.inf else odds + here), outside if window else beyond
    return odds, hidden


def assignments_of(model: DetectionModel, count: int, seed: int) -> NDArray[np.int64]:
    """Random assignments of three or more points, each to a detection of its own image."""
    rng, (n, n2) = np.random.default_rng(seed), model.shape
    out = np.full((count, n), -1)
    for row in out:
        points = rng.permutation(n)[: rng.integers(3, 6)]
        row[points] = rng.permutation(n2)[: len(points)]
    return out


def near(at: Gaussian, seed: int) -> tuple[Floats, Floats]:
    """A pose about a prediction."""
    step = np.random.default_rng(seed).normal(size=6) * np.sqrt(np.diag(at.covariance))
    return Rotation.from_rotvec(step[:3]).as_matrix() @ at.rotation, at.position + step[3:]


PREDICTED = Gaussian(
    Rotation.from_rotvec([0.3, -0.2, 0.7]).as_matrix(), np.array([0.02, -0.05, 0.6]),
    np.diag([1e-3, 2e-3, 1e-3, 1e-4, 1e-4, 4e-4]), freedom=8.0,
)  # fmt: skip
MIXTURE = Doubted(
    [PREDICTED, replace(PREDICTED, position=np.array([0.1, 0.0, 0.7]))], [math.log(0.7), math.log(0.29)], Broad(), 0.01
)
WEIGHTS = np.random.default_rng(5).normal(size=(6, 9))
CASES: dict[str, tuple[CameraModel, dict[str, object]]] = {
    "normals": (PINHOLE, {}),
    "normals, no view angle": (PINHOLE, {"view_cosine": None}),
    "bare": (FISHEYE, {"normals": None, "view_cosine": None}),
    "weights": (BROWN, {"log_weights": WEIGHTS, "allowed": WEIGHTS > -1.8, "rate": 0.8}),
    "size": (replace(PINHOLE, size=SIZES[0]), {}),
    "blobs": (PINHOLE, {"resolution": 20.0}),
    "source noise": (PINHOLE, {"source_covariance": np.tile(np.diag([1e-6, 2e-6, 4e-6]), (6, 1, 1))}),
    "rig": (rig(SIZES), {}),
    "predicted": (PINHOLE, {"prior": MIXTURE}),
}


@pytest.mark.parametrize("name", CASES)
def test_evidence_is_the_formula(name: str) -> None:
    camera, more = CASES[name]
    model, R, position = scene(camera, seed=1001, poses=12, **more)
    if name == "predicted":
        R[:6], position[:6] = (np.array(one) for one in zip(*(near(PREDICTED, k) for k in range(6)), strict=True))
    assignments = assignments_of(model, len(R), 1002)
    if name == "blobs":
        at = model.linearise_about(R, position)
        assert at.blob is not None
        assignments = np.where(at.blob == np.arange(6), assignments, -1)
    found, _ = weigh_poses(model, assignments, R, position)
    finite = 0
    for k in range(len(R)):
        value, detected, step, covariance, squared, freedom, shown = log_evidence(
            model, assignments[k], R[k], position[k], model.prior
        )
        # the limit of distance is integrated over in steps
        unknown = model.normals is not None and model.view_cosine is None
        np.testing.assert_allclose(found.visible[k], shown, rtol=2e-2 if unknown else 1e-6, atol=1e-12)
        if not np.isfinite(value + detected):
            assert found.log_odds[k] == -np.inf
            continue
        finite += 1
        scale = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(
            found.covariance[k] / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=1e-6
        )
        np.testing.assert_allclose(found.step[k] / scale, step / scale, atol=1e-5 * (1.0 + np.abs(step / scale).max()))
        assert found.squared[k] == pytest.approx(squared, rel=1e-6, abs=1e-6)
        assert found.freedom[k] == pytest.approx(freedom, abs=1e-6)
        assert found.detected[k] == pytest.approx(detected, abs=0.05)
        assert found.log_odds[k] - found.detected[k] == pytest.approx(value, rel=1e-8, abs=1e-6)
    assert finite >= 6


def test_many_hidden_points_do_not_underflow() -> None:
    missing = np.full(5000, 0.99)
    missing[7] = 0.0
    exact = 4999 * math.log1p(-0.9 * 0.99) + math.log(0.9)
    value = log_over_rates(missing, 1, np.array([0.9]), np.zeros(1), np.empty((2, 1)))
    assert value == pytest.approx(exact, rel=1e-12)


def test_steps() -> None:
    model, R, position = scene(PINHOLE)
    found, at = weigh_poses(model, assignments_of(model, len(R), 1007), R, position)
    step = np.random.default_rng(1008).normal(size=(len(R), 6)) * np.geomspace(1e-9, 1.0, len(R))[:, None]
    rotation, moved = step_poses(found._replace(step=step), at)
    shortened = 0
    for k in range(len(R)):
        length = max(np.linalg.norm(step[k, :3]), np.linalg.norm(step[k, 3:]) / np.linalg.norm(position[k]))
        part = step[k] * min(1.0, 0.5 / length)
        shortened += length > 0.5
        np.testing.assert_allclose(rotation[k], Rotation.from_rotvec(part[:3]).as_matrix() @ R[k], atol=1e-14)
        np.testing.assert_allclose(moved[k], position[k] + part[3:], rtol=1e-13)
    assert 0 < shortened < len(R)


def test_evidence_of_no_assignment_is_of_the_prior() -> None:
    model, _, _ = scene(PINHOLE, prior=MIXTURE)
    found = weigh_assignments(
        model, np.full((1, 6), -1), model.linearise_about(PREDICTED.rotation[None], PREDICTED.position[None])
    )
    np.testing.assert_allclose(found.covariance[0], PREDICTED.covariance, rtol=1e-4, atol=1e-9)
    assert found.squared[0] == pytest.approx(0.0, abs=1e-9)


class TestPriors:
    def test_a_broad_one_is_a_normal_distribution_of_its_volume(self) -> None:
        position = np.array([[0.1, -0.2, 0.7], [0.0, 0.0, -3.0]])
        terms = Broad().terms(np.tile(np.eye(3), (2, 1, 1)), position)
        for k, distance in enumerate(np.linalg.norm(position, axis=1)):
            volume = 8.0 * math.pi**2 * FIELD * math.log(DEPTHS) * distance**3
            peak = 0.5 * np.linalg.slogdet(terms.precision[k] / (2.0 * math.pi))[1]
            assert terms.log_density[k] == pytest.approx(-math.log(volume))
            assert peak == pytest.approx(-math.log(volume))
            along = position[k] / distance
            assert along @ terms.precision[k, 3:, 3:] @ along == pytest.approx(
                2.0 * math.pi / (distance * math.log(DEPTHS)) ** 2
            )
        assert not terms.slope.any()

    @pytest.mark.parametrize("freedom", [4.0, 8.0, math.inf])
    def test_a_prediction_is_normal_with_the_tails_of_a_student_distribution(self, freedom: float) -> None:
        """Its axes may have turned with the body, or not."""

        def log_shape(squared: float) -> float:
            if squared <= 6.0 or freedom == math.inf:
                return -0.5 * squared
            return -3.0 - (freedom / 2 + 3) * (math.log1p(squared / freedom) - math.log1p(6.0 / freedom))

        def shell(radius: float) -> float:
            return math.pi**3 * radius**5 * math.exp(log_shape(radius**2)) / (2.0 * math.pi) ** 3

        mass = quad(shell, 0.0, math.sqrt(6.0))[0] + quad(shell, math.sqrt(6.0), math.inf)[0]
        prior = replace(PREDICTED, freedom=freedom)
        rng = np.random.default_rng(1003)
        for _ in range(20):
            step = rng.normal(size=6) * np.sqrt(np.diag(prior.covariance)) * rng.choice([0.1, 1.0, 5.0])
            turn = Rotation.from_rotvec(step[:3]).as_matrix()
            terms = prior.terms((turn @ prior.rotation)[None], (prior.position + oracles.moved_along_arc(step))[None])
            both = np.kron(np.eye(2), turn)
            covariance = oracles.in_either_axes(prior.covariance, both @ prior.covariance @ both.T)
            peak = multivariate_normal(np.zeros(6), covariance).logpdf(np.zeros(6)) - math.log(mass)
            squared = float(both @ step @ np.linalg.solve(covariance, both @ step))
            exact = peak + log_shape(squared)
            assert terms.log_density[0] - 0.5 * terms.squared[0] == pytest.approx(exact, abs=1e-3, rel=1e-4)
            weight = 1.0 if freedom == math.inf else min((freedom + 6) / (freedom + squared), 1.0)
            slope = -weight * np.linalg.solve(covariance, both @ step)
            np.testing.assert_allclose(terms.slope[0], slope, rtol=1e-4, atol=1e-3)
            np.testing.assert_allclose(terms.precision[0] @ covariance, weight * np.eye(6), atol=1e-3)

    @pytest.mark.parametrize("freedom", [4.0, 8.0, math.inf])
    def test_an_image_that_tells_little_leaves_a_prediction_as_sure_as_it_was(self, freedom: float) -> None:
        """Three detections with the noise of half an image, at the predicted pose: Kalman's covariance."""
        covariance = np.diag(np.repeat([1e-3, 1e-4], 3) ** 2)
        prior = Gaussian(PREDICTED.rotation, PREDICTED.position, covariance, freedom=freedom)
        points = np.random.default_rng(6).uniform(-0.1, 0.1, (6, 3))
        points -= points.mean(axis=0)
        pixels = PINHOLE.project(points @ prior.rotation.T + prior.position)
        for noise in (300.0, 1.0):
            model = DetectionModel(PINHOLE, points, pixels, np.full(6, noise), prior=prior)
            assignment = np.where(np.arange(6) < 3, np.arange(6), -1)[None]
            at = model.linearise_about(prior.rotation[None], prior.position[None])
            J = at.jacobian[0, :3].reshape(6, 6) / noise
            exact = np.linalg.inv(np.linalg.inv(covariance) + J.T @ J)
            found = weigh_assignments(model, assignment, at).covariance[0]
            scale = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
            np.testing.assert_allclose(found / scale, exact / scale, atol=1e-4)

    def test_the_largest_component_stands_for_a_mixture(self) -> None:
        rng = np.random.default_rng(1004)
        R = Rotation.random(40, random_state=4).as_matrix()
        position = rng.uniform((-0.2, -0.2, 0.3), (0.2, 0.2, 1.0), (40, 3))
        for k in range(30):
            R[k], position[k] = near(MIXTURE.predictions[k % 2], k)  # type: ignore[arg-type]
        found, which = MIXTURE.terms(R, position), MIXTURE.prediction_indices(R, position)
        assert set(which.tolist()) == {-1, 0, 1}
        every = [prior.terms(R, position) for prior in (*MIXTURE.predictions, MIXTURE.without)]
        gains = [one.log_gain(MIXTURE.without.radius) for one in MIXTURE.predictions]  # type: ignore[attr-defined]
        shares = [*np.add(MIXTURE.log_shares, gains).tolist(), math.log(MIXTURE.doubt)]
        for k in range(40):
            values = [
                one.log_density[k] + share - 0.5 * one.squared[k] for one, share in zip(every, shares, strict=True)
            ]
            best = int(np.argmax(values))
            assert which[k] == (best if best < 2 else -1)
            assert found.log_density[k] == pytest.approx(every[best].log_density[k] + shares[best])
            np.testing.assert_allclose(found.precision[k], every[best].precision[k], rtol=1e-12)

    @pytest.mark.parametrize("axis", np.vstack([np.eye(3), [[0.6, -0.8, 0.0], [0.577, 0.577, 0.577]]]).tolist())
    def test_half_turn_off_a_prediction(self, axis: list[float]) -> None:
        axis = (np.array(axis) / np.linalg.norm(axis)).tolist()
        turned = Rotation.from_rotvec(math.pi * np.array(axis)).as_matrix() @ PREDICTED.rotation
        squared = replace(PREDICTED, freedom=math.inf).terms(turned[None], PREDICTED.position[None]).squared[0]
        both = np.kron(np.eye(2), turned @ PREDICTED.rotation.T)
        covariance = oracles.in_either_axes(PREDICTED.covariance, both @ PREDICTED.covariance @ both.T)
        off = math.pi * np.array([*axis, 0.0, 0.0, 0.0])
        assert squared == pytest.approx(off @ np.linalg.solve(covariance, off), rel=1e-3)


@pytest.mark.parametrize("name", ["pinhole", "fisheye", "chart", "rig"])
@pytest.mark.parametrize("matched", [3, 4, 5])
def test_poses_of_few_matches(name: str, matched: int) -> None:
    """The true pose is among them, and all that put three of the matches on their rays, of a rig on one camera's.

    Of the camera with the most matches: what fits in several is among what fits there. Of a rig, if two cameras see
    three of the points, these have one place and the body one pose.
    """
    camera = CAMERAS[name]
    model, _, _ = scene(camera, poses=2)
    R, position = Rotation.from_rotvec([0.3, -0.2, 0.4]).as_matrix(), np.array([0.02, 0.03, 0.8])
    pixels = model.linearise_about(R[None], position[None]).pixels[0]
    n, views = 6, len(pixels) // 6
    model = replace(model, target=pixels)
    if isinstance(camera, RigImage):
        model = replace(model, camera=replace(camera, camera_of=np.repeat(np.arange(views), n)))
    assignments = np.full((2, n * views), -1)
    assignments[1, :matched] = np.arange(matched)
    if views == 2:
        assignments[1, n : n + matched] = n + np.arange(matched)
        assert not len(propose_few_matched(model, assignments).assignments)
        assignments[1, n + 2 :] = -1
    found = propose_few_matched(model, assignments)
    assert len(found.assignments) >= 1
    np.testing.assert_array_equal(found.assignments, np.repeat(assignments[1:], len(found.assignments), axis=0))
    off = np.linalg.norm(found.position - position, axis=1) + np.linalg.norm(found.rotation - R, axis=(1, 2))
    assert off.min() < 1e-6
    own = np.isin(np.arange(n * views), np.arange(matched))
    chosen = wide_triples(pixels[None], own[None])[0]
    points, rays = (model.points - model.centre)[chosen], model.rays[chosen]
    turns, shifts = camera_frames(model.camera)
    for rotations, translations, corners, seen in zip(*solve_triples(points, rays), points, rays, strict=True):
        for turn, shift in zip(rotations, translations, strict=True):
            places = corners @ turn.T + shift
            if not np.linalg.norm(places / np.linalg.norm(places, axis=1)[:, None] - seen) < 1e-7:
                continue  # none, or one of a root that is only nearly real
            turn, shift = turns[0].T @ turn, turns[0].T @ (shift - shifts[0])
            off = np.linalg.norm(found.position - shift, axis=1)
            assert (off + np.linalg.norm(found.rotation - turn, axis=(1, 2))).min() < 1e-5


def test_more_matches_than_few_have_no_minimal_sets() -> None:
    model, _, _ = scene(PINHOLE)
    assignments = np.array([[0, 1, -1, -1, -1, -1], [0, 1, 2, 3, 4, 5]])
    assert len(propose_few_matched(model, assignments).assignments) <= 16
    points = np.random.default_rng(1009).uniform(-0.06, 0.06, (9, 3))
    more = replace(model, points=points, normals=None, view_cosine=None)
    assert len(propose_few_matched(more, np.arange(9)[None]).assignments) == 0


def test_more_points_than_few_that_cameras_share_out_have_no_minimal_sets() -> None:
    """Six matches in one camera, and in another one two of the same points, or of others."""
    model, _, _ = scene(CAMERAS["rig"])
    assert isinstance(model.camera, RigImage)
    n, views = 9, len(model.points) // 6
    points = np.tile(np.random.default_rng(1009).uniform(-0.06, 0.06, (n, 3)), (views, 1))
    camera = replace(model.camera, count=n, camera_of=np.repeat(np.arange(views), n))
    model = replace(model, camera=camera, points=points, normals=None, view_cosine=None)
    pixels = model.linearise_about(np.eye(3)[None], np.array([[0.02, 0.03, 0.8]])).pixels[0]
    model = replace(model, target=pixels, sigma=np.ones(len(pixels)))
    same, others = np.full((2, n * views), -1)
    same[:6], same[n : n + 2] = np.arange(6), n + np.arange(2)
    others[:6], others[n + 6 : n + 8] = np.arange(6), n + np.arange(6, 8)
    assert len(propose_few_matched(model, same[None]).assignments)
    assert not len(propose_few_matched(model, others[None]).assignments)


def one_sided(rng: np.random.Generator, count: int) -> Floats:
    """Covariances (count, 2, 2) of rank one."""
    along = rng.normal(size=(count, 2))
    return np.asarray(along[:, :, None] * along[:, None])


@pytest.mark.parametrize("weighed", [False, True])
def test_gates(weighed: bool) -> None:
    more = {"log_weights": WEIGHTS, "allowed": WEIGHTS > -1.0} if weighed else {}
    model, R, position = scene(PINHOLE, seed=1005, **more)
    at = model.linearise_about(R[:1], position[:1])
    covariance = np.diag([1e-2, 1e-2, 1e-2, 1e-3, 1e-3, 1e-3]) + 1e-4
    shown = np.linspace(0.05, 1.0, 6)
    of_points = np.tile(np.array([[4.0, 1.0], [1.0, 3.0]]), (6, 1, 1))
    target, sigma, weights, *_ = model.image_for_kernels
    candidates, gains, assignment = np.empty((6, 9), np.bool_), np.empty((6, 9)), np.empty(6, np.int64)
    gate(
        (at.pixels[0], at.jacobian[0], of_points, shown), covariance,
        (*model.gating_image[:4], weights),
        (16.0, 0.9, 0.1), (candidates, gains, assignment),
    )  # fmt: skip
    for i in range(6):
        for j in range(9):
            spread = at.jacobian[0, i] @ covariance @ at.jacobian[0, i].T + of_points[i] + sigma[j] ** 2 * np.eye(2)
            off = target[j] - at.pixels[0, i]
            squared = float(off @ np.linalg.inv(spread) @ off)
            log_density = multivariate_normal(at.pixels[0, i], spread).logpdf(target[j])
            chance = 0.9 * shown[i]
            gain = log_density + math.log(chance / (1.0 - chance)) - model.clutter.log_density[j]
            possible = squared <= 16.0 and shown[i] > 0.1
            if weighed:
                gain, possible = gain + WEIGHTS[i, j], possible and bool(WEIGHTS[i, j] > -1.0)
            assert candidates[i, j] == possible
            if not weighed or WEIGHTS[i, j] > -1.0:
                assert gains[i, j] == pytest.approx(gain, rel=1e-6)
    good = candidates & (gains > 0.0)
    assert good.any()
    check_assignment(good, gains, assignment)


def check_assignment(good: NDArray[np.bool_], gains: Floats, assignment: NDArray[np.int64]) -> None:
    """That an assignment has the largest sum of gains of all that are one to one."""
    matched = np.flatnonzero(assignment >= 0)
    assert good[matched, assignment[matched]].all()
    assert len(set(assignment[matched].tolist())) == len(matched)
    worth = np.where(good, gains, 0.0)
    best = worth[linear_sum_assignment(worth, maximize=True)].sum()
    assert gains[matched, assignment[matched]].sum() == pytest.approx(best, rel=1e-12)


@pytest.mark.parametrize("shape", [(1, 1), (3, 9), (9, 3), (12, 12), (0, 4), (4, 0)])
def test_the_best_assignment(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng([1051, *shape])
    for share in (0.2, 0.5, 1.0):
        for _ in range(20):
            candidates, gains = rng.random(shape) < share, rng.normal(1.0, 2.0, shape)
            assignment = np.empty(shape[0], np.int64)
            assign_likeliest(candidates, gains, assignment)
            check_assignment(candidates & (gains > 0.0), gains, assignment)


@pytest.mark.parametrize("name", ["plain", "weights", "source noise", "blurred"])
def test_gains_of_single_matches(name: str) -> None:
    """Each is what a fit without the point's own match predicts, by normal equations that leave that match out."""
    more: dict[str, object] = {}
    if name == "weights":
        more = {"log_weights": WEIGHTS, "allowed": WEIGHTS > -1.0}
    model, R, position = scene(PINHOLE, seed=1010, poses=3, **more)
    at = model.linearise_about(R[:1], position[:1])
    assert at.seen.all()
    assignment = np.array([0, 1, 2, 3, 4, -1])
    rng = np.random.default_rng(1011)
    own = model.sigma[:, None, None] ** 2 * np.eye(2)
    if name == "blurred":
        more = {"target_covariance": (own := own + 2.0 * one_sided(rng, 9))}
    model = replace(model, target=model.target.copy(), **more)
    model.target[:5] = at.pixels[0, :5] + rng.normal(0.0, 0.5, (5, 2))
    uncertain = name == "source noise"
    of_points = np.tile(float(uncertain) * np.array([[0.5, 0.1], [0.1, 0.3]]), (6, 1, 1))
    P = np.diag([1.0, 1.0, 1.0, 100.0, 100.0, 100.0])
    rows = [at.jacobian[0, i] for i in range(6)]
    noise = [of_points[i] + own[j] for i, j in enumerate(assignment)]
    each = [rows[i].T @ np.linalg.inv(noise[i]) @ rows[i] if assignment[i] >= 0 else 0.0 * P for i in range(6)]
    off = [model.target[j] - at.pixels[0, i] for i, j in enumerate(assignment)]
    push = [rows[i].T @ np.linalg.inv(noise[i]) @ off[i] if assignment[i] >= 0 else np.zeros(6) for i in range(6)]
    # the mode's pose is the best one, so that residuals are about it
    step = np.linalg.solve(P + sum(each), sum(push))
    pixels = at.pixels[0] + np.array([row @ step for row in rows])
    covariance = np.linalg.inv(P + sum(each))
    visible_by = np.linspace(0.3, 1.0, 6)
    gains, log_count = np.empty((6, 9)), rng.normal(size=9)
    fill_match_gains(
        assignment, (pixels, at.jacobian[0], of_points[: 6 * uncertain], visible_by, at.seen[0]),
        covariance,
        (*model.gating_image, log_count), 0.8, gains,
    )  # fmt: skip
    for i in range(6):
        without = P + sum(one for k, one in enumerate(each) if k != i)
        there = np.linalg.solve(without, sum(one for k, one in enumerate(push) if k != i))
        predicted = at.pixels[0, i] + rows[i] @ there
        spread = rows[i] @ np.linalg.inv(without) @ rows[i].T + of_points[i]
        for j in range(9):
            log_density = multivariate_normal(predicted, spread + own[j]).logpdf(model.target[j])
            chance = 0.8 * visible_by[i]
            gain = log_density + math.log(chance / (1.0 - chance)) - model.clutter.log_density[j] + log_count[j]
            if name == "weights":
                gain = gain + WEIGHTS[i, j] if WEIGHTS[i, j] > -1.0 else -np.inf
            assert gains[i, j] == pytest.approx(gain, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("centres", [np.array([0, 2, 3, 7]), np.arange(9)], ids=["some", "all"])
def test_densities_of_crowds(centres: NDArray[np.int64], size: int) -> None:
    rng = np.random.default_rng(1012)
    target, sigma = rng.uniform(0.0, 300.0, (9, size)), rng.uniform(0.3, 0.8, 9)
    label = np.array([0, 0, 1, 1, 0, 0, 1, 0, 1])
    widths = np.minimum(80.0 * 0.5 ** np.arange(SCALES)[:, None], [80.0, 30.0, 0.1][:size])
    about, whole = np.empty((SCALES, 9, len(centres))), np.empty((SCALES, 9))
    fill_crowd_densities.py_func(target, sigma, centres, label, widths, about, whole, 0, len(target))  # type: ignore[attr-defined]
    for k in range(SCALES):
        for i in range(9):
            for c, j in enumerate(centres):
                spread = np.diag(widths[k] ** 2 + sigma[i] ** 2 + sigma[j] ** 2)
                density = (
                    multivariate_normal(target[j], spread).pdf(target[i]) if i != j and label[i] == label[j] else 0.0
                )
                assert about[k, i, c] == pytest.approx(density, rel=1e-9, abs=1e-300)
    assert (about > 0.0).any()
    np.testing.assert_allclose(whole, about.sum(axis=2) / (len(centres) - 1), rtol=1e-12)
    uniform, extents = rng.uniform(1e-5, 2e-5, 9), np.array([320.0, 120.0, 0.4][:size])
    out = np.empty((9, len(centres))), np.empty((SCALES, size)), np.empty(SCALES + 1)
    parts = *out, np.empty_like(about), np.empty((SCALES + 1, 9))
    for rows in ((0, 4), (4, 9)):
        fit_crowds((target, sigma, uniform, label), centres, extents, (PSEUDO, 0.1 / SCALES, STEPS), rows, parts)
    mean = 0.25 * np.prod(extents) ** (1.0 / size)
    widths = np.minimum(mean * 0.5 ** np.arange(SCALES)[:, None], 0.25 * extents)
    fill_crowd_densities.py_func(target, sigma, centres, label, widths, about, whole, 0, len(target))  # type: ignore[attr-defined]
    prior = np.array([PSEUDO, *[0.1 / SCALES] * SCALES])
    shares = prior / prior.sum()
    fit_crowd_shares(np.vstack([uniform, whole]), prior, STEPS, shares)
    expected = (shares[1:, None, None] * about).sum(axis=0), widths, shares
    for one, other in zip(out, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)


def test_shares_of_crowds_are_those_of_expectation_and_maximisation() -> None:
    densities = np.random.default_rng(1006).uniform(0.0, 1.0, (SCALES + 1, 30)) ** 4
    prior = np.array([PSEUDO, *[PSEUDO / SCALES] * SCALES])
    shares = prior / prior.sum()
    expected = shares.copy()
    for _ in range(STEPS):
        responsible = expected[:, None] * densities / (expected @ densities)
        expected = responsible.sum(axis=1) + prior
        expected = expected / expected.sum()
    fit_crowd_shares(densities, prior, STEPS, shares)
    np.testing.assert_allclose(shares, expected, rtol=1e-12)
    assert np.abs(shares - prior / prior.sum()).max() > 0.01


@pytest.mark.parametrize("singular", [False, True])
def test_poses_that_are_one_within_their_covariances(singular: bool) -> None:
    """By normal equations; also where a direction has no variance to speak of."""
    rng, same = np.random.default_rng(1013), []
    for _ in range(300):
        roots = rng.normal(0.0, 0.05, (2, 6, 6))
        if singular:
            roots[:, 1] = 1e-9 * rng.normal(size=(2, 6))
        first, second = (root @ root.T for root in roots)
        R, position = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
        step = roots[0] @ rng.normal(size=6) * rng.uniform(0.0, 2.0)
        turned, moved = Rotation.from_rotvec(step[:3]).as_matrix() @ R, rng.normal(0.0, 0.01, 6) * rng.integers(0, 2)
        moved[1] = 0.0 if singular else moved[1]
        place = position + step[3:]
        antisymmetric = 0.5 * (turned @ R.T - (turned @ R.T).T)
        off = np.concatenate([antisymmetric[[2, 0, 1], [1, 2, 0]], step[3:]]) - moved
        spread = first + second
        scale = np.sqrt(np.diag(spread))
        unit = off / scale
        correlation = spread / np.outer(scale, scale) + 1e-12 * np.eye(6)
        squared = float(unit @ np.linalg.solve(correlation, unit))
        if abs(squared - 4.0) > 1e-3:
            same.append(squared < 4.0)
            assert is_same_pose((turned, place, first), (R, position, second), moved, 2.0) == same[-1]
    assert 50 < sum(same) < len(same) - 50


def test_opposite_poses_are_never_one() -> None:
    turned, wide = Rotation.from_rotvec([0.0, 1.1, 0.0]).as_matrix(), 100.0 * np.eye(6)
    poses = (turned, np.zeros(3), wide), (np.eye(3), np.zeros(3), wide)
    assert not is_same_pose(*poses, np.zeros(6), 2.0)
    assert is_same_pose(poses[0], poses[0], np.zeros(6), 2.0)
