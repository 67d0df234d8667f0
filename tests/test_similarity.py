"""Rigid and similar triangles against brute force over the motion, and matches in the plane and in space."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import oracles
from robot_scenes import moved_points
from rootmatch import Status, match, residuals
from rootmatch.backends import cpu
from rootmatch.errors import InputError
from rootmatch.hypergraph.affinity import affinity
from rootmatch.io.pose_files import pose_record
from rootmatch.problems.residual_kinds import QR, SVD, Joint, Normalised, QRBoth
from rootmatch.problems.similarity.problem import Rigid, Similarity
from rootmatch.samplers.exhaustive import exhaustive_tensor
from rootmatch.solvers import get_solver

CASES = [(Similarity, 2), (Similarity, 3), (Rigid, 2), (Rigid, 3)]


def made(
    problem: type[Similarity], dimension: int, seed: int, noise: float, n: int = 8, outliers: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    scale = 1.0 if problem is Rigid else 0.5 + 0.3 * (seed % 7)
    return moved_points(dimension, n, outliers, noise, seed, scale)


def best_motion_chi2(source: np.ndarray, target: np.ndarray, sigma: float, rigid: bool, truth: np.ndarray) -> float:
    """Least squared distances over σ² of both noisy triangles to exact ones, over all motions near the truth."""
    dimension = source.shape[1]
    turns = 3 if dimension == 3 else 1

    def residual(v: np.ndarray) -> np.ndarray:
        turn, shift, log_scale = v[:turns], v[turns : turns + dimension], v[turns + dimension]
        points = v[turns + dimension + 1 :].reshape(source.shape)
        rotation = (
            Rotation.from_rotvec(turn).as_matrix()
            if dimension == 3
            else np.array([[np.cos(turn[0]), -np.sin(turn[0])], [np.sin(turn[0]), np.cos(turn[0])]])
        )
        scale = 1.0 if rigid else np.exp(log_scale)
        moved = scale * points @ rotation.T @ truth.T + shift
        return np.concatenate(((points - source).ravel(), (moved - target).ravel())) / sigma

    # the truth's linear part, from many points; the motion is sought near it
    scale = np.cbrt(np.linalg.det(truth)) if dimension == 3 else np.sqrt(np.linalg.det(truth))
    truth = truth / scale
    shift = target.mean(axis=0) - scale * truth @ source.mean(axis=0)
    start = np.concatenate((np.zeros(turns), shift, [np.log(scale)], source.ravel()))
    return 2.0 * float(least_squares(residual, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14).cost)


@pytest.mark.parametrize(("problem", "dimension"), CASES)
def test_joint_is_the_distance_to_the_best_motion(problem: type[Similarity], dimension: int) -> None:
    sigma = 1e-4
    errors = []
    index = np.arange(3)[None]
    for seed in range(30):
        source, target, truth = made(problem, dimension, seed, sigma)
        exact_source, exact_target, _ = made(problem, dimension, seed, 0.0)
        first, second = exact_source, exact_target[truth]
        linear = np.linalg.lstsq(first - first.mean(axis=0), second - second.mean(axis=0), rcond=None)[0].T
        tables = problem(dimension).prepare(source[:3], target[truth][:3], sigma)
        value = cpu.residuals(tables, Joint(), index, index)[0]
        expected = best_motion_chi2(source[:3], target[truth][:3], sigma, problem is Rigid, linear)
        errors.append(abs(value**2 - expected) / max(expected, 0.1))
    assert np.quantile(errors, 0.5) < 0.01
    assert np.quantile(errors, 0.9) < 0.1


@pytest.mark.parametrize(("problem", "dimension"), CASES)
def test_calibration(problem: type[Similarity], dimension: int) -> None:
    joint, single = [], []
    for seed in range(40):
        source, target, truth = made(problem, dimension, seed, 0.003)
        rng = np.random.default_rng(seed)
        edges = np.array([rng.permutation(8)[:3] for _ in range(60)])
        args = (source, target, problem(dimension), edges, truth[edges])
        joint.append(residuals(*args, "joint", 0.003))
        single.append(residuals(*args, "normalised", 0.003))
    for values, freedom in ((joint, problem.constraints), (single, 1)):
        squares = np.concatenate(values) ** 2
        for share in (0.5, 0.9):
            assert abs(np.mean(squares < chi2.ppf(share, freedom)) - share) < 0.06


@pytest.mark.parametrize(("kind", "oracle"), [(QR, oracles.qr), (QRBoth, oracles.qr_both), (SVD, oracles.svd)])
def test_resultants_of_the_sides(kind: type, oracle: object) -> None:
    source, target, truth = made(Similarity, 3, 4, 0.05)
    tables = Similarity(3).prepare(source, target, 0.05)
    rng = np.random.default_rng(0)
    for bit, order in enumerate(((0, 1, 2), (1, 0, 2), (2, 0, 1))):
        edges = np.array([rng.permutation(8)[:3] for _ in range(10)])
        for i, j in zip(edges, truth[edges], strict=True):
            a, b, c = order
            p, q = (
                Similarity(3).coefficients(source[None, [i[a], i[k]]], target[None, [j[a], j[k]]])[0] for k in (b, c)
            )
            value = cpu.residuals(tables, kind(1 << bit), i[None], j[None])[0]
            assert value == pytest.approx(oracle(p, q), rel=1e-9)  # type: ignore[operator]


@pytest.mark.parametrize(("problem", "dimension"), CASES)
def test_slab_is_edge_by_edge(problem: type[Similarity], dimension: int) -> None:
    """All hyper-edges of an exhaustive search against a list of them, where the slab is more than a loop over edges."""
    source, target, _ = made(problem, dimension, 5, 0.01, n=5)
    tables = problem(dimension).prepare(source, target, 0.01)
    every = oracles.all_hyperedges(5, 5, 3)
    i, j = (np.array([edge[side] for edge in every]) for side in (0, 1))
    for kind in (Joint(), Normalised(), Normalised(0b110)):
        name = {Joint: "joint", Normalised: "normalised"}[type(kind)]
        weigh = affinity(name, rho=1.0, gate=1e9)
        tensor, evaluated = exhaustive_tensor(tables, kind, weigh, (5, 5), 3)
        assert evaluated == len(every)
        expected = dict(
            zip(map(tuple, np.sort(i * 5 + j, axis=1)), weigh.weights(cpu.residuals(tables, kind, i, j)), strict=True)
        )
        for row, weight in zip(tensor.indices, tensor.weights, strict=True):
            # the residual of one pair depends on which two sides are compared; both loops take them in source order
            assert weight == pytest.approx(expected[tuple(sorted(row))], rel=1e-9, abs=1e-300)


@pytest.mark.parametrize("dimension", [2, 3])
def test_match_of_similar_sets(dimension: int) -> None:
    for seed in range(5):
        source, target, truth = made(Similarity, dimension, seed, 0.01, n=10, outliers=4)
        found = match(source, target, Similarity(dimension), noise=0.01)
        assert found.status is Status.MATCHED
        # in a plane a stray point may lie as near as the right one, and points are left out: either may be a ghost
        matched = found.assignment >= 0
        assert np.array_equal(found.assignment[matched], truth[matched])
        assert matched.sum() >= (10 if dimension == 3 else 8)


@pytest.mark.parametrize("dimension", [2, 3])
def test_rigid_sets_by_all_hyperedges_and_the_ascent(dimension: int) -> None:
    for seed in range(5):
        source, target, truth = made(Rigid, dimension, seed, 0.01, n=10, outliers=4)
        weigh = affinity("joint")
        tables = Rigid(dimension).prepare(source, target, 0.01)
        tensor, _ = exhaustive_tensor(tables, Joint(), weigh, (10, 14), 3)
        assert np.array_equal(get_solver("ascent")(tensor, seed=0).assignment, truth)


def test_a_mirrored_set_of_a_plane_matches_only_where_that_is_allowed() -> None:
    source, target, truth = moved_points(2, 8, seed=1, mirror=True)
    index = np.array([[0, 1, 2], [3, 5, 7]])
    forbidden = residuals(source, target, Similarity(2), index, truth[index], "joint", 0.01)
    allowed = residuals(source, target, Similarity(2, mirror=True), index, truth[index], "joint", 0.01)
    assert np.all(forbidden >= 1e6)
    assert np.all(allowed < 1e-6)


def test_a_mirrored_set_in_space_is_trusted_only_where_that_is_allowed() -> None:
    """Its hyper-edges agree all the same; but no rotation fits more than a few points, and a reflection does."""
    source, target, truth = moved_points(3, 8, noise=0.01, seed=4)
    mirrored = source * [-1.0, 1.0, 1.0]
    assert match(source, target, Rigid(3), noise=0.01).status is Status.MATCHED
    refused = match(mirrored, target, Rigid(3), noise=0.01)
    assert not np.array_equal(refused.assignment, truth)
    assert refused.status is Status.UNTRUSTED
    (rotation,) = refused.poses
    assert rotation is not None
    assert np.linalg.det(rotation.R) == pytest.approx(1.0)
    found = match(mirrored, target, Rigid(3, mirror=True), noise=0.01)
    assert found.status is Status.MATCHED
    (pose,) = found.poses
    assert pose is not None
    assert np.linalg.det(pose.R) == pytest.approx(-1.0)
    assert pose.rms is not None
    assert pose.rms < 0.03
    assert pose_record(pose)["quaternion"] is None
    with pytest.raises(InputError, match="no quaternion"):
        _ = pose.quaternion


def test_the_scale_tells_rigid_from_similar() -> None:
    source, target, truth = moved_points(3, 8, seed=2, scale=1.3)
    index = np.array([[0, 1, 2], [3, 5, 7]])
    assert np.all(residuals(source, target, Similarity(3), index, truth[index], "joint", 0.01) < 1e-6)
    assert np.all(residuals(source, target, Rigid(3), index, truth[index], "joint", 0.01) > 10.0)


def test_noise_of_model_and_scan_apart() -> None:
    source, target, truth = moved_points(3, 6, noise=0.01, seed=3)
    index = np.array([[0, 1, 2]])
    both = residuals(source, target, Rigid(3), index, truth[index], "joint", (0.01, 0.01))[0]
    assert residuals(source, target, Rigid(3), index, truth[index], "joint", 0.01)[0] == pytest.approx(both)
    # an exact model: half of the variance
    exact = residuals(source, target, Rigid(3), index, truth[index], "joint", (0.0, 0.01))[0]
    assert exact == pytest.approx(np.sqrt(2.0) * both, rel=0.05)


@pytest.mark.parametrize("kind", ["joint", "normalised", "qr", "qr-both", "svd"])
def test_degenerate_triples_are_finite_and_collinear_ones_say_nothing(kind: str) -> None:
    line = np.column_stack((np.arange(4.0), 2.0 * np.arange(4.0)))
    source = np.concatenate((line, [[0.3, 5.0]]))
    index = np.array([[0, 1, 2], [1, 2, 3], [0, 1, 4]])
    values = residuals(source, source + 3.0, Similarity(2), index, index, kind, 0.01)
    assert np.all(np.isfinite(values))
    assert values[2] < 1e-6
    if kind == "joint":
        assert np.all(values[:2] >= 1e6)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"source": np.ones((5, 2)) * np.arange(5.0)[:, None]}, "shape"),
        ({"target": np.zeros((5, 3))}, "points 0 and 1 are the same"),
        ({"noise": -1.0}, "noise"),
        ({"normals": np.ones((5, 3))}, "normals"),
        ({"source": np.eye(3)[:2]}, "at least 3"),
    ],
)
def test_bad_input(change: dict[str, object], text: str) -> None:
    points = np.random.default_rng(0).normal(size=(5, 3))
    with pytest.raises(InputError, match=text):
        Similarity(3).prepare(**{"source": points, "target": points, **change})  # type: ignore[arg-type]


def test_bad_dimension() -> None:
    with pytest.raises(InputError, match="dimension"):
        Similarity(4)
