"""The model of two point sets: its evidence against sampling, its posterior against the sum over all labellings."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp

import rootmatch as rm
from rootmatch.explain.point_set_decision import make_point_set_model
from rootmatch.explain.task import MatchingTask
from rootmatch.model.exact_symmetry import fit_exact_shape
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.model.point_set_posterior import weigh_point_set_posterior
from rootmatch.model.priors import NOISE_FREEDOM, PRESENT
from rootmatch.problems.points import PointClouds
from rootmatch.problems.pose_fit.point_set_fit import DECADES
from rootmatch.samplers.point_sets.congruent import congruent_labellings

NOISE = (0.2, 0.3)


def scene(
    source: np.ndarray, seed: int, missing: int = 0, stray: int = 0, noise: tuple[float, float] = NOISE
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The source as measured, the targets, and the truth."""
    rng = np.random.default_rng([seed, 5])
    n, k = source.shape
    turn = Rotation.random(rng=rng).as_matrix() if k == 3 else rotation_of_plane(rng.uniform(-np.pi, np.pi))
    moved, seen = source @ turn.T + 100.0, rng.permutation(n)[: n - missing]
    strays = rng.uniform(moved.min(axis=0) - 10.0, moved.max(axis=0) + 10.0, (stray, k))
    targets = np.concatenate([moved[seen] + noise[1] * rng.normal(size=(n - missing, k)), strays])
    order = rng.permutation(len(targets))
    truth = np.full(n, -1)
    truth[seen] = np.argsort(order)[: n - missing]
    return source + noise[0] * rng.normal(size=source.shape), targets[order], truth


def rotation_of_plane(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def clouds_of(source: np.ndarray, target: np.ndarray, sigma: float, scaled: bool = False) -> PointClouds:
    u, v = np.full(len(source), 0.5 * sigma**2), np.full(len(target), 0.5 * sigma**2)
    return PointClouds(source, target, u, v, scaled, mirror=False)


def sampled_density(source: np.ndarray, target: np.ndarray, sigma: float, scaled: bool) -> float:
    """Logarithm of the mean likelihood of targets over motions and factors of σ, by importance sampling.

    Motions are drawn about the best one, rotations as turns with their invariant density; shares no formula but those.
    """
    rng = np.random.default_rng(0)
    m, k = source.shape
    scale = np.linalg.norm(target - target.mean(0)) / np.linalg.norm(source - source.mean(0)) if scaled else 1.0
    first = source - source.mean(axis=0)
    if k == 3:
        best = Rotation.align_vectors(target - target.mean(axis=0), first)[0].as_matrix()
    else:
        a, b = (points[:, 0] + 1j * points[:, 1] for points in (first, target - target.mean(axis=0)))
        best = rotation_of_plane(float(np.angle((np.conj(a) * b).sum())))
    # as far as points are from the axis about which they tell a turn worst
    moments = np.linalg.eigvalsh(first.T @ first / m)
    count, radius = 50_000, float(np.sqrt(moments.sum() - (moments[-1] if k == 3 else 0.0)))
    spread = 1.5 * sigma / (scale * radius * np.sqrt(m))
    draws = rng.standard_t(6, (count, 3 if k == 3 else 1)) * spread
    log_q = student_t(draws / spread, 6.0).sum(axis=1) - draws.shape[1] * np.log(spread)
    if k == 3:
        angle = np.linalg.norm(draws, axis=1)
        inside = angle < np.pi
        log_p = np.log(2.0 * (1.0 - np.cos(angle)) / angle**2) - np.log(8.0 * np.pi**2)
        turns = Rotation.from_rotvec(draws).as_matrix() @ best
    else:
        inside = np.abs(draws[:, 0]) < np.pi
        log_p = np.full(count, -np.log(2.0 * np.pi))
        turns = np.array([rotation_of_plane(one) for one in draws[:, 0]]) @ best
    step = 1.5 * sigma / np.sqrt(m)
    shift = rng.standard_t(6, (count, k)) * step
    log_q += student_t(shift / step, 6.0).sum(axis=1) - k * np.log(step)
    scales = np.full(count, scale)
    if scaled:
        width = 1.5 * sigma / (scale * np.linalg.norm(first))
        drawn = rng.standard_t(6, count) * width
        log_q += student_t(drawn / width, 6.0) - np.log(width)
        log_p = log_p - np.log(DECADES * np.log(10.0))
        scales = scale * np.exp(drawn)
    moved = scales[:, None, None] * first @ turns.swapaxes(1, 2) + target.mean(axis=0) + shift[:, None]
    variance = 0.5 * sigma**2 * (1.0 + scales**2)
    chi2 = ((moved - target) ** 2).sum(axis=(1, 2)) / variance
    # the factor of the variances on a grid of its logarithm, under its inverse gamma prior
    log_factor = np.linspace(-2.5, 3.5, 60)
    prior = -0.5 * NOISE_FREEDOM * (log_factor + np.exp(-log_factor))
    prior -= logsumexp(prior)
    likelihood = np.full(count, -np.inf)
    for value, weight in zip(log_factor, prior, strict=True):
        likelihood = np.logaddexp(likelihood, weight - 0.5 * (chi2 * np.exp(-value) + m * k * value))
    likelihood -= 0.5 * m * k * np.log(2.0 * np.pi * variance)
    return float(logsumexp(np.where(inside, likelihood + log_p - log_q, -np.inf)) - np.log(count))


def student_t(x: np.ndarray, nu: float) -> np.ndarray:
    """Log density of Student's t; its constant for six degrees of freedom."""
    return np.log(0.3827327723098716) - 0.5 * (nu + 1.0) * np.log1p(x**2 / nu)


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("sigma", [0.02, 0.1])
def test_evidence_is_that_of_sampled_motions(size: int, scaled: bool, sigma: float) -> None:
    """σ of a fiftieth and of a tenth of the object's size: Laplace's method is then off by less than 0.1."""
    rng = np.random.default_rng([size, 3])
    source = rng.uniform(-1.0, 1.0, (4, size)) * 1.5
    turn = Rotation.random(rng=rng).as_matrix() if size == 3 else rotation_of_plane(2.0)
    target = (1.3 if scaled else 1.0) * source @ turn.T + sigma * rng.normal(size=source.shape) + 5.0
    model = PointSetModel(clouds_of(source, target, sigma, scaled))
    found = float(model.log_density(model.fit(np.arange(4)[None]))[0])
    assert found == pytest.approx(sampled_density(source, target, sigma, scaled), abs=0.1)


def test_what_is_counted_is_what_is_integrated() -> None:
    """The detection rate and the density of clutter, by quadrature."""
    source, target, _ = scene(np.random.default_rng(0).uniform(-20.0, 20.0, (6, 3)), 0, missing=1, stray=3)
    model = PointSetModel(clouds_of(source, target, 0.3))
    n, n_target = 6, len(target)
    for m in (3, 5):
        assignment = np.where(np.arange(n) < m, np.arange(n), -1)[None]
        judged = model.judge(assignment)
        counted = float((judged.log_odds - model.log_density(judged.fit) - model.log_factors(judged.fit)[0])[0])
        counted += model.log_volume
        hidden = judged.fit.assignments < 0
        rate = quad(lambda d, m=m: d**m * (1.0 - d) ** (n - m), 0.0, 1.0)[0]
        clutter = [quad(lambda x, c=c: x ** (c - 0.5) * np.exp(-x), 0.0, np.inf)[0] for c in (n_target - m, n_target)]
        # λ is integrated, of which crowds about hidden points have their parts
        about = model.clutter_about_points(judged.fit, hidden)[0] * np.exp(model.clutter.log_density)
        more = (1.0 - model.clutter.alone) * (m + 1) / (n + 2) * (n - m) / n_target
        density = log_density_of_clutter(model, list(range(m)), about) + (n_target - m + 0.5) * np.log1p(more)
        assert counted == pytest.approx(np.log(rate * clutter[0] / clutter[1]) - density, rel=1e-6)


def log_density_of_clutter(model: PointSetModel, taken: list[int], more: np.ndarray) -> float:
    """Logarithm of the density of some targets as clutter, given that others crowd about places too (``more``)."""
    clutter, count = model.clutter, len(model.clouds.target)

    def forests(own: list[int], extra: np.ndarray | float) -> float:
        about = clutter.about / (count - 1)
        whole = np.diag(clutter.alone * clutter.uniform + extra + about.sum(axis=1)) - about
        return float(np.linalg.slogdet(whole[np.ix_(own, own)])[1])

    return forests([*range(count)], 0.0) - forests([j for j in range(count) if j not in taken], more)


def test_clutter_crowds_in_forests() -> None:
    """Two targets do not predict each other, and what is left may crowd about places where nothing was detected.

    Each lies anywhere, about a place, or about another target that is no follower of its own.
    """
    rng, count = np.random.default_rng(2), 5
    target = rng.uniform(-50.0, 50.0, (count, 3))
    target[1], target[3] = target[0] + 1.5, target[2] - 1.0
    clutter = (model := PointSetModel(clouds_of(target[:4], target, 0.3))).clutter
    more = np.array([0.0, 1.0, 0.0, 3.0, 0.5])
    extra = more * np.exp(clutter.log_density)
    total = 0.0
    for parents in itertools.product(range(-1, count), repeat=count):
        product = 1.0
        for j, parent in enumerate(parents):
            anywhere = clutter.alone * clutter.uniform[j]
            product *= anywhere if parent < 0 else clutter.about[j, parent] / (count - 1)
            for _ in range(count):
                parent = parents[parent] if parent >= 0 else -1
            product *= parent < 0
        total += product
    assert log_density_of_clutter(model, [*range(count)], extra) == pytest.approx(np.log(total))
    for taken in ([0], [0, 1], [2, 4], []):
        expected = log_density_of_clutter(model, taken, extra)
        used = np.isin(np.arange(count), taken)
        assert clutter.log_density_of_taken(used[None], more[None])[0] == pytest.approx(expected, abs=1e-9)
        each = clutter.log_density_of_each(used, more)
        for j in range(count):
            others = sorted({*taken} ^ {j})
            change = log_density_of_clutter(model, others, extra) - expected
            assert each[j] == pytest.approx(change if j not in taken else -change, abs=1e-9)


def test_a_ghost_of_a_hidden_marker_is_not_that_marker() -> None:
    """Four of six markers are seen, and each of the six has a reflection 5 to 8 σ away with .6.

    With clutter that crowds about targets alone, 22 of 26 trusted were wrong.
    """
    trusted = wrong = 0
    for seed in range(80):
        rng = np.random.default_rng(seed)
        source = rng.uniform(-80.0, 80.0, (6, 3))
        moved = source @ Rotation.random(rng=rng).as_matrix().T + 900.0
        seen, away = rng.permutation(6)[:4], rng.normal(size=(6, 3))
        away *= rng.uniform(1.5, 2.4, (6, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
        target = np.concatenate([moved[seen] + 0.3 * rng.normal(size=(4, 3)), (moved + away)[rng.random(6) < 0.6]])
        truth = np.full(6, -1)
        truth[seen] = np.arange(4)
        found = rm.match(source, target, rm.Rigid(), noise=(0.0, 0.3))
        trusted += bool(found)
        wrong += bool(found) and bool(((found.assignment >= 0) & (found.assignment != truth)).any())
    assert trusted >= 10
    assert wrong <= 4


def test_residuals_beyond_the_noise_make_a_match_less_probable() -> None:
    """As of images: something else of nearly the shape may be there. Not where σ is estimated."""
    rng = np.random.default_rng(0)
    source = rng.uniform(-80.0, 80.0, (8, 3))
    moved, noise = source @ Rotation.random(rng=rng).as_matrix().T, rng.normal(size=(8, 3))
    told = [rm.match(source, moved + sigma * noise, rm.Rigid(), noise=(0.0, 0.3)) for sigma in (0.3, 0.6, 0.9)]
    probable = [match.probability for match in told]
    assert probable[0] == pytest.approx(0.999)
    assert 0.95 < probable[1] < 0.998
    assert probable[2] < 0.7
    for match in told[1:]:
        np.testing.assert_allclose(match.confidence, match.probability, atol=0.01)
    assert rm.match(source, moved + 0.9 * noise, rm.Rigid(), noise="auto").probability == pytest.approx(0.999)


def test_clutter_turns_with_the_targets() -> None:
    """Whatever the frame: the box and its crowds turn with the targets."""
    rng = np.random.default_rng(8)
    target = np.concatenate([rng.uniform(-300.0, 300.0, (6, 3)) * [1.0, 0.5, 0.2], rng.normal(0.0, 20.0, (6, 3))])
    turned = target @ Rotation.random(rng=rng).as_matrix().T + 1000.0
    model, same = (PointSetModel(clouds_of(target[:4], one, 0.3)) for one in (target, turned))
    np.testing.assert_allclose(same.clutter.log_density, model.clutter.log_density, atol=1e-6)
    assert same.log_volume == pytest.approx(model.log_volume)
    assert np.mean(model.clutter.log_density[6:]) > np.mean(model.clutter.log_density[:6]) + 1.5, "a crowd is dense"


def test_markers_of_other_tools_are_hardly_one_that_is_absent() -> None:
    """Five tools of five markers each are in view, a sixth is asked for; nine of 400 were trusted with uniform clutter.

    Of the 60 scenes each with the sixth in view as well, all markers are found.
    """
    absent = present = 0
    for seed in range(1100, 1300):
        rng = np.random.default_rng([seed, 99])
        tools, placed = rng.uniform(-50.0, 50.0, (6, 5, 3)), []
        for tool in tools:
            turn = Rotation.random(rng=rng).as_matrix()
            placed.append(tool @ turn.T + rng.uniform(-250.0, 250.0, 3) + 0.2 * rng.normal(size=(5, 3)))
        strays = rng.uniform(-300.0, 300.0, (3, 3))
        absent += bool(rm.match(tools[0], np.concatenate([*placed[1:], strays]), rm.Rigid(), noise=0.2))
        if seed < 1160:
            found = rm.match(tools[0], np.concatenate([*placed, strays]), rm.Rigid(), noise=0.2)
            present += bool(found) and (found.assignment == np.arange(5)).all()
    assert absent <= 2
    assert present == 60


def test_a_reflection_counts_where_it_is_allowed() -> None:
    source, target, _ = scene(np.random.default_rng(3).uniform(-20.0, 20.0, (6, 3)), 0)
    clouds = clouds_of(source, target * [-1.0, 1.0, 1.0], 0.4)
    everything = np.array(list(itertools.permutations(range(6))))
    odds = {mirror: PointSetModel(clouds, mirror).judge(everything).log_odds for mirror in (False, True)}
    assert odds[True].max() > 20.0
    assert odds[False].max() < -20.0


def test_posterior_is_the_sum_over_all_labellings() -> None:
    """Of three points or more; nine targets of which some are near each other."""
    source = np.array([[30.0, 0.0, 0.0], [-28.0, 5.0, 0.0], [0.0, 25.0, 10.0], [3.0, -20.0, 15.0]])
    for seed in range(4):
        measured, target, _ = scene(source, seed, missing=seed % 2, stray=2)
        target = np.concatenate([target, target[:1] + 0.8])
        model = make_point_set_model(MatchingTask.of(rm.Rigid(), measured, target, noise=NOISE))
        assert model is not None
        n, n_target = len(measured), len(target)
        every = np.array(
            [
                one
                for one in itertools.product(range(-1, n_target), repeat=n)
                if sum(j >= 0 for j in one) >= 3 and len({j for j in one if j >= 0}) == sum(j >= 0 for j in one)
            ]
        )
        odds = model.judge(every).log_odds
        expected = np.exp(odds - np.logaddexp(logsumexp(odds), np.log(1.0 / PRESENT - 1.0)))
        found = weigh_point_set_posterior(model, model.judge(congruent_labellings(model.clouds, False).proper))
        shares = {one.tobytes(): share for one, share in zip(found.assignments, found.probabilities, strict=True)}
        for k in np.argsort(-expected)[:4]:
            assert shares.get(every[k].tobytes(), 0.0) == pytest.approx(expected[k], abs=0.02)
        each, _ = found.confidence
        marginal = expected @ (every == found.assignments[0]) + (1.0 - expected.sum()) * (found.assignments[0] < 0)
        np.testing.assert_allclose(each, marginal, atol=0.05)


FLAT = np.array([[30.0, 40, 0], [-30, 40, 0], [45, 0, 0], [-45, 0, 0], [25, -45, 0], [-25, -45, 0]])
RECTANGLE = np.array([[40.0, 25, 0], [-40, 25, 0], [-40, -25, 0], [40, -25, 0], [0, 0, 20], [0, 0, 55]])


@pytest.mark.parametrize("source", [FLAT, RECTANGLE, RECTANGLE[:4]])
def test_symmetric_sets_are_ambiguous_and_the_truth_is_listed(source: np.ndarray) -> None:
    for seed in range(6):
        measured, target, truth = scene(source, seed, stray=1)
        match = rm.match(measured, target, rm.Rigid(), noise=NOISE)
        assert match.status is rm.Status.AMBIGUOUS
        listed = [match.assignment, *(other for other, _ in match.alternatives[:5])]
        assert any(np.array_equal(one, truth) for one in listed)
        assert match.probability == pytest.approx(0.5 if len(source) == 6 else 0.25, abs=0.1)


def test_a_symmetry_is_exact_within_the_noise_only() -> None:
    turned = np.array([1, 0, 3, 2, 5, 4]), np.array([2, 3, 0, 1, 4, 5])
    rng = np.random.default_rng(1)
    for source, second in ((FLAT, turned[0]), (RECTANGLE, turned[1])):
        exact, displaced = [], []
        for _ in range(20):
            measured = source + 0.2 * rng.normal(size=source.shape)
            off = measured + 4.0 * (np.arange(6) == 5)[:, None] * [1.0, 0.0, 0.0]
            for points, results in ((measured, exact), (off, displaced)):
                shape = fit_exact_shape(points, np.tile(0.04 * np.eye(3), (6, 1, 1)), [(np.arange(6), second)])
                results.append(-np.inf if shape is None else shape.log_odds)
        assert np.quantile(exact, 0.1) > 0.0
        assert np.max(displaced) < np.log(0.01)


def test_two_points_beside_each_other_are_no_exact_symmetry() -> None:
    """Were it exact, both would be in one place; so of what fits, that with them exchanged is as rare as it fits."""
    source = np.array([[23.0, 6.9], [34.5, 3.2], [30.0, 15.5], [21.7, 29.0], [9.0, 14.0], [29.2, 4.0], [26.5, 14.1]])
    for size in (2, 3):
        points = np.pad(np.vstack([source, [26.4, 13.6]]), ((0, 0), (0, size - 2)))
        points[:, size - 1 :] += np.arange(8.0)[:, None] * (size - 2)
        exchanged = np.arange(8)
        exchanged[[6, 7]] = [7, 6]
        covariance = np.tile(0.01 * np.eye(size), (8, 1, 1))
        assert fit_exact_shape(points, covariance, [(np.arange(8), exchanged)]) is None
        pair = np.array([6, 7])  # of these alone, a half turn may be one
        assert fit_exact_shape(points, covariance, [(pair, pair[::-1])]) is not None


def test_mirrored_sets_are_not_trusted() -> None:
    for seed in range(8):
        source = np.random.default_rng([seed, 1]).uniform(-60.0, 60.0, (8, 3))
        measured, target, truth = scene(source, seed)
        assert np.array_equal(rm.match(measured, target, rm.Rigid(), noise=NOISE).assignment, truth)
        mirrored = rm.match(measured, target * [1.0, -1.0, 1.0], rm.Rigid(), noise=NOISE)
        assert mirrored.status is rm.Status.UNTRUSTED


def test_a_layout_that_a_reflection_exchanges_is_told_by_its_heights() -> None:
    """Left and right exchanged fit a reflection only, which is no motion."""
    source = FLAT + np.array([0.0, 0, 10]) * np.array([1, 1, -1, -1, 1, 1])[:, None]
    for seed in range(6):
        measured, target, truth = scene(source, seed)
        match = rm.match(measured, target, rm.Rigid(), noise=NOISE)
        assert match.status is rm.Status.MATCHED
        assert np.array_equal(match.assignment, truth)


@pytest.mark.parametrize("problem", [rm.Rigid(), rm.Similarity()])
@pytest.mark.parametrize("size", [2, 3])
def test_unrelated_sets_are_not_trusted(problem: rm.Similarity, size: int) -> None:
    for seed in range(10):
        rng = np.random.default_rng([seed, size])
        match = rm.match(rng.uniform(-1, 1, (6, size)), rng.uniform(-1, 1, (8, size)), problem, noise=0.005)
        assert match.status is not rm.Status.MATCHED
        assert match.probability is not None
        assert match.probability < 0.9
        assert np.all(match.confidence[match.assignment >= 0] < 0.9)


@pytest.mark.parametrize("option", [{}, {"sampler": "exhaustive"}, {"solver": "hgm"}, {"sampler": "guided"}])
def test_four_of_six_points_among_strays_by_any_method(option: dict[str, str]) -> None:
    source = np.random.default_rng(8).uniform(-60.0, 60.0, (6, 3))
    for seed in range(3):
        measured, target, truth = scene(source, seed, missing=2, stray=3)
        match = rm.match(measured, target, rm.Rigid(), noise=NOISE, **option)  # type: ignore[arg-type]
        assert match.status is rm.Status.MATCHED
        assert np.array_equal(match.assignment, truth)
        assert match.probability is not None
        assert 0.9 <= match.probability <= match.confidence.min() + 1e-9
