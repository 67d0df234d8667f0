"""RRWHM, HGM, BCAGM, and what all solvers share."""

import numba
import numpy as np
import pytest
import scipy.optimize

from rootmatch.errors import InputError
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers import (
    SOLVERS,
    BlockCoordinateAscent,
    KLProjection,
    MultiStartAscent,
    PowerIteration,
    ReweightedWalk,
    get_solver,
)
from rootmatch.solvers.bcagm import _Ascent
from rootmatch.solvers.hgm import project
from rootmatch.solvers.rrwhm import balance_matrix
from solver_oracles import best_score, dense_contraction, dense_tensor, naive_score, planted, random_edges

SHAPES = [(2, 6, 6), (3, 6, 7), (3, 7, 6), (4, 6, 6), (4, 6, 8), (5, 7, 7)]


def noise(seed, n, n_target, order, count, unary=False):
    rng = np.random.default_rng(seed)
    indices = random_edges(rng, n, n_target, order, count)
    return AffinityTensor(indices, rng.random(count), (n, n_target), rng.random((n, n_target)) if unary else None)


# --- all solvers -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(SOLVERS))
@pytest.mark.parametrize(("order", "n", "n_target"), SHAPES)
def test_every_solver_finds_a_clear_assignment(name, order, n, n_target):
    indices, weights, truth = planted(order, n, n_target, order, 20 if order == 2 else 60)
    tensor = AffinityTensor(indices, weights, (n, n_target))
    solution = get_solver(name)(tensor)
    assert solution.converged
    assert solution.score == pytest.approx(tensor.score(solution.assignment), rel=1e-9)
    assert solution.soft.shape == (n, n_target)
    assert np.isfinite(solution.soft).all()
    assert (solution.soft >= 0).all()
    seen = truth >= 0
    np.testing.assert_array_equal(solution.assignment[seen], truth[seen])
    for image, value in solution.alternatives:
        assert not np.array_equal(image, solution.assignment)
        assert value == pytest.approx(tensor.score(image), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("name", sorted(SOLVERS))
def test_every_solver_is_the_same_on_any_number_of_threads(name):
    indices, weights, _ = planted(3, 9, 10, 3, 90_000)
    tensor = AffinityTensor(indices, weights, (9, 10))
    threads = numba.get_num_threads()
    try:
        answers = []
        for count in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(count)
            answers.append(get_solver(name)(tensor, seed=count))
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_array_equal(answers[0].soft, answers[1].soft)
    np.testing.assert_array_equal(answers[0].assignment, answers[1].assignment)
    assert answers[0].score == answers[1].score


@pytest.mark.parametrize("name", sorted(SOLVERS))
def test_every_solver_survives_empty_and_lonely_hyperedges(name):
    empty = get_solver(name)(AffinityTensor(np.zeros((0, 3), np.int32), [], (4, 5)))
    assert empty.assignment.tolist() == [-1] * 4
    assert empty.status.startswith("empty")
    lonely = get_solver(name)(AffinityTensor([[0, 6, 12]], [1e-200], (4, 5)))
    assert lonely.assignment.tolist()[:3] == [0, 1, 2]
    assert lonely.score == 1e-200
    assert np.isfinite(lonely.soft).all()


@pytest.mark.parametrize("name", sorted(SOLVERS))
def test_unary_weights_tip_the_balance(name):
    edges = [[0, 5], [1, 4]]  # (0,0)-(1,1) against (0,1)-(1,0), in 2 × 4
    unary = np.zeros((2, 4))
    unary[0, 1] = 0.3
    solution = get_solver(name)(AffinityTensor(edges, [1.0, 1.0], (2, 4), unary))
    assert solution.assignment.tolist() == [1, 0]
    assert solution.score == pytest.approx(1.3)


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        (ReweightedWalk, {"walk": 2.0}),
        (ReweightedWalk, {"inflation": 1e4}),
        (ReweightedWalk, {"iterations": 0}),
        (KLProjection, {"matches": 0}),
        (KLProjection, {"tolerance": float("nan")}),
        (KLProjection, {"iterations": 0}),
        (BlockCoordinateAscent, {"iterations": 0}),
        (BlockCoordinateAscent, {"keep": -1}),
        (MultiStartAscent, {"agreement": 0}),
        (PowerIteration, {"keep": -1}),
    ],
)
def test_options_are_judged(kind, options):
    with pytest.raises(InputError):
        kind(**options)


# --- RRWHM -----------------------------------------------------------------------------------------------------------


def naive_walk(dense, shape, steps, walk=0.2, inflation=30.0):
    n, n_target = shape
    x = np.full(shape, 1 / (n * n_target))
    for _ in range(steps):
        w = dense_contraction(dense, x)
        y = np.exp(inflation * w / w.max())
        padded = np.vstack([y, np.ones((1, n_target))])
        rows = np.append(np.ones(n), n_target - n)
        for _ in range(3000):
            if n_target > n:
                padded *= (rows / padded.sum(axis=1))[:, None]
                padded /= padded.sum(axis=0)
            else:
                padded = padded[:n] / padded[:n].sum(axis=1, keepdims=True)
                padded /= padded.sum(axis=0)
        y = padded[:n]
        x = walk * w / w.sum() + (1 - walk) * y / y.sum()
    return x


@pytest.mark.parametrize(("order", "n", "n_target"), [(2, 5, 5), (3, 4, 6), (4, 5, 5)])
def test_walk_follows_the_equations(order, n, n_target):
    tensor = noise(order, n, n_target, order, 300)
    dense = dense_tensor(tensor.indices, tensor.weights, n * n_target)
    for steps in (1, 3):
        soft = ReweightedWalk(iterations=steps, balancing=3000)(tensor).soft
        np.testing.assert_allclose(soft, naive_walk(dense, (n, n_target), steps), atol=1e-4)


@pytest.mark.parametrize("shape", [(5, 5), (4, 7), (7, 4)])
def test_balanced_matrix_has_the_sums_of_an_assignment(shape):
    rng = np.random.default_rng(0)
    y = np.exp(30 * rng.random(shape))
    x = balance_matrix(y, 20000, 1e-10)
    short, long = (1, 0) if shape[0] <= shape[1] else (0, 1)
    np.testing.assert_allclose(x.sum(axis=short), 1, rtol=1e-8)
    assert (x.sum(axis=long) <= 1 + 1e-8).all()
    # Scaling of rows and columns only: the ratios of 2 × 2 minors stay.
    ratio = x / y
    np.testing.assert_allclose(ratio[0, 0] * ratio[1, 1], ratio[0, 1] * ratio[1, 0], rtol=1e-9)


def test_balancing_is_bounded():
    y = np.array([[1.0, 1e-120], [1.0, 1e-120]])
    assert np.isfinite(balance_matrix(y, 5)).all()


def test_without_slack_both_sets_are_balanced_to_equal_sums():
    y = np.random.default_rng(2).random((3, 7)) + 0.1
    for x in (balance_matrix(y, 2000, 1e-12, slack=False), balance_matrix(y.T, 2000, 1e-12, slack=False).T):
        np.testing.assert_allclose(x.sum(axis=1), x.sum() / 3)
        np.testing.assert_allclose(x.sum(axis=0), x.sum() / 7)
        ratio = x / y
        np.testing.assert_allclose(ratio * ratio[0, 0], ratio[:, :1] * ratio[:1])
    # many steps between sets of very different sizes neither overflow nor vanish
    y = np.exp(30 * np.random.default_rng(3).random((3, 60)))
    x = balance_matrix(y, 5000, 0.0, slack=False)
    np.testing.assert_allclose(x.sum(axis=1), 1)
    np.testing.assert_allclose(x.sum(axis=0), 3 / 60)
    indices, weights, _ = planted(3, 5, 9, 3, 300)
    tensor = AffinityTensor(indices, weights, (5, 9))
    assert np.any(ReweightedWalk(slack=False)(tensor).soft != ReweightedWalk()(tensor).soft)


# --- HGM -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("shape", "matches"), [((3, 3), 3), ((3, 4), 3), ((4, 3), 2), ((3, 3), 2)])
def test_projection_is_the_nearest_in_relative_entropy(shape, matches):
    rng = np.random.default_rng(matches)
    y = rng.random(shape) * 2 + 0.05
    x, _, _ = project(y, float(matches), 100_000, 1e-13)

    def distance(flat):
        z = np.maximum(flat.reshape(shape), 1e-300)
        return (z * np.log(z / y) - z + y).sum()

    limits = [
        scipy.optimize.LinearConstraint(np.kron(np.eye(shape[0]), np.ones(shape[1])), -np.inf, 1),
        scipy.optimize.LinearConstraint(np.kron(np.ones(shape[0]), np.eye(shape[1])), -np.inf, 1),
        scipy.optimize.LinearConstraint(np.ones(y.size), matches, matches),
    ]
    start = np.full(y.size, matches / y.size)
    reference = scipy.optimize.minimize(
        distance,
        start,
        jac=lambda flat: np.log(np.maximum(flat, 1e-300) / y.ravel()),
        bounds=[(1e-9, 1)] * y.size,
        constraints=limits,
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert x.sum() == pytest.approx(matches, rel=1e-9)
    assert x.sum(axis=1).max() <= 1 + 1e-9
    assert x.sum(axis=0).max() <= 1 + 1e-9
    assert distance(x.ravel()) <= reference.fun + 1e-7
    np.testing.assert_allclose(x.ravel(), reference.x, atol=1e-4)


def test_projection_starts_from_the_marginals():
    tensor = noise(1, 4, 4, 3, 200, unary=True)
    dense = dense_tensor(tensor.indices, tensor.weights, 16)
    y = dense_contraction(dense, np.ones((4, 4))) + tensor.unary
    expected, _, _ = project(y / y.max(), 4.0, 10_000, 1e-9)
    np.testing.assert_allclose(KLProjection()(tensor).soft, expected, rtol=1e-9)


def test_no_more_matches_than_the_hyperedges_allow():
    # Three source points compete for two targets.
    edges = [[0, 6], [6, 10], [0, 11]]  # (0,0) (1,1) (2,0) (2,1) of 5 columns
    solution = KLProjection()(AffinityTensor(edges, [1.0, 1.0, 1.0], (3, 5)))
    assert solution.statistics["matches"] == 2
    assert solution.converged
    assert np.sum(solution.assignment >= 0) == 2
    few = KLProjection(matches=1)(AffinityTensor(edges, [1.0, 1.0, 1.0], (3, 5)))
    assert few.soft.sum() == pytest.approx(1)


# --- BCAGM -----------------------------------------------------------------------------------------------------------


def dense_form(tensor, blocks):
    """F of the blocks from the dense tensor; at odd order the mean over all choices of d of the blocks."""
    order = tensor.order
    dense = dense_tensor(tensor.indices, tensor.weights, tensor.shape[0] * tensor.shape[1])
    letters = "abcdef"[:order]
    value, sets = 0.0, 0
    for skip in range(len(blocks)) if len(blocks) > order else [None]:
        chosen = [b.ravel() for s, b in enumerate(blocks) if s != skip]
        value += np.einsum(f"{letters},{','.join(letters)}->", dense, *chosen)
        sets += 1
    return value / sets / np.prod(np.arange(1, order + 1))


@pytest.mark.parametrize(("order", "n", "n_target"), [(2, 4, 5), (3, 4, 4), (4, 4, 4)])
@pytest.mark.parametrize("alpha", [0.0, 0.7])
def test_form_and_slope_of_the_blocks(order, n, n_target, alpha):
    tensor = noise(order, n, n_target, order, 150, unary=True)
    run = _Ascent(tensor)
    rng = np.random.default_rng(0)
    run.x = [rng.random((n, n_target)) for _ in run.x]
    run.key = [bytes([b]) for b in range(run.blocks)]
    run.alpha = alpha
    x = run.x
    expected = dense_form(tensor, x) + np.mean([(tensor.unary * y).sum() for y in x])
    inner = np.array([[(y * z).sum() for z in x] for y in x])
    if run.blocks == 2:
        expected += alpha * inner[0, 1]
    else:
        expected += alpha * (inner[0, 1] * inner[2, 3] + inner[0, 2] * inner[1, 3] + inner[0, 3] * inner[1, 2]) / 3
    assert run.value() == pytest.approx(expected, rel=1e-9)
    # The form is linear in each block: the slope is the difference that a step makes.
    for b in range(run.blocks):
        slope, before, step = run.gradient(b), run.value(), rng.random((n, n_target))
        run.x[b], old = run.x[b] + step, run.x[b]
        run.key[b] += b"+"
        assert run.value() - before == pytest.approx((slope * step).sum(), rel=1e-8)
        run.x[b] = old
        run.key[b] = run.key[b][:-1]


@pytest.mark.parametrize(("order", "n", "n_target"), [(2, 6, 7), (3, 7, 7), (3, 6, 8), (3, 8, 6), (4, 6, 6), (5, 6, 6)])
def test_block_ascent_is_monotone(order, n, n_target):
    for seed in range(4):
        tensor = noise(seed, n, n_target, order, 400 if order > 2 else 80, unary=seed % 2 == 1)
        run = _Ascent(tensor)
        run.round()
        value, alpha, best = run.value(), run.alpha, 0.0
        for _ in range(100):
            if run.settled:
                break
            run.round()
            if run.alpha == alpha:
                assert run.value() >= value * (1 - 1e-12)
            value, alpha = run.value(), run.alpha
            assert run.score >= best
            best = run.score
        assert run.settled
        assert len(set(run.key)) == 1
        expected = naive_score(tensor.indices, tensor.weights, run.winner, n_target)
        if tensor.unary is not None:
            expected += sum(tensor.unary[i, k] for i, k in enumerate(run.winner) if k >= 0)
        assert run.score == pytest.approx(expected, rel=1e-9)


def test_score_against_the_optimum_of_tiny_instances():
    """Block ascent is local: at the optimum more often than not. The multi-start ascent always is, on these."""
    hits, total = 0, 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        n, n_target = (int(m) for m in rng.integers(3, 6, 2))
        order = int(rng.integers(2, min(n, n_target, 4) + 1))
        tensor = noise(seed, n, n_target, order, int(rng.integers(5, 60)))
        best = best_score(tensor.indices, tensor.weights, tensor.shape)
        score = BlockCoordinateAscent()(tensor).score
        assert score <= best + 1e-9
        hits += score >= best - 1e-9
        total += 1
        assert MultiStartAscent()(tensor).score == pytest.approx(best, rel=1e-9)
    assert hits > total / 2
