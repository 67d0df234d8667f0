"""Guided search: what it finds of what exhaustion finds, at what cost, and where most is hidden or forbidden."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numba
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rootmatch.api import match
from rootmatch.backends import cpu
from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError
from rootmatch.hypergraph import enumeration
from rootmatch.hypergraph.affinity import affinity
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems.base import Problem
from rootmatch.problems.kernels import ProblemKernels
from rootmatch.problems.p3p.problem import P3P
from rootmatch.result import Status
from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.guided.candidate_hyperedges import CHANCE_SAMPLES
from rootmatch.samplers.guided.detection_grid import NARROWEST, gate_factor
from rootmatch.samplers.guided.minimal_sets import minimal_sets, remaining_points, widest_sets, width
from rootmatch.samplers.guided.sampler import Guided, pays
from rootmatch.samplers.guided.stopping import StoppingOptions
from rootmatch.simulation import Scene, p3p_scene, up2p_scene
from rootmatch.solvers import MultiStartAscent

SCENES: dict[str, Callable[..., Scene]] = {"p3p": p3p_scene, "up2p": up2p_scene}
WEIGH = affinity("joint")


def search(
    problem: Problem, source: NDArray[np.float64], target: NDArray[np.float64], noise: float = 1.0, **options: object
) -> SampledTensor:
    """Guided tensor of points as they are."""
    normals = options.pop("normals", None)
    tables = problem.prepare(source, target, noise, normals)
    kind = WEIGH.residual.kernel_kind(problem.pair_count)
    guided = options.pop("options", Guided())
    return guided(SamplingTask(tables, kind, WEIGH, (len(source), len(target)), problem.order, **options))


def of_scene(scene: Scene, **options: object) -> SampledTensor:
    return search(scene.problem, scene.source, scene.target, scene.noise, **options)


def true_information(scene: Scene) -> float:
    """Sum of the weights of the true hyper-edges, each evaluated by itself."""
    problem = scene.problem
    seen = np.flatnonzero(scene.truth >= 0)
    source = seen[np.array(list(combinations(range(len(seen)), problem.order)))]
    tables = problem.prepare(scene.source, scene.target, scene.noise)
    kind = WEIGH.residual.kernel_kind(problem.pair_count)
    residuals = cpu.residuals(tables, kind, source, scene.truth[source])
    return float(np.exp(-0.5 * residuals[residuals <= WEIGH.gate] ** 2).sum())


@pytest.mark.parametrize("name", SCENES)
def test_all_but_5_percent_of_the_information_at_a_50th_of_the_evaluations(name: str) -> None:
    for seed in range(200, 206):
        scene = SCENES[name](20, 20, noise=1.0, seed=seed)
        found = of_scene(scene, seed=seed)
        assert found.tensor.score(scene.truth) >= 0.95 * true_information(scene)
        evaluated = found.evaluated + found.tensor.size
        assert evaluated <= enumeration.exhaustive_count(20, 40, scene.problem.order) / 50
        assert found.share == 1.0


@pytest.mark.parametrize("name", SCENES)
def test_weights_are_those_of_the_ordinary_residual_and_no_hyperedge_comes_twice(name: str) -> None:
    scene = SCENES[name](9, 6, noise=1.0, seed=1)
    tensor, *_ = of_scene(scene)
    source, target = np.divmod(tensor.indices.astype(np.int64), 15)
    tables = scene.problem.prepare(scene.source, scene.target, 1.0)
    residuals = cpu.residuals(tables, WEIGH.residual.kernel_kind(scene.problem.pair_count), source, target)
    assert np.array_equal(np.exp(-0.5 * residuals**2), tensor.weights)
    assert residuals.max() <= WEIGH.gate
    assert tensor.merged().size == tensor.size
    AffinityTensor(tensor.indices, tensor.weights, tensor.shape)  # judges every index


@pytest.mark.parametrize("kind", ["qr", "normalised"])
def test_any_kind_of_residual_weighs_what_is_proposed(kind: str) -> None:
    scene = p3p_scene(8, 4, noise=0.5, seed=4)
    weigh = affinity(kind)
    tables = scene.problem.prepare(scene.source, scene.target, 0.5)
    tensor, *_ = Guided()(SamplingTask(tables, weigh.residual.kernel_kind(6), weigh, (8, 12), 4))
    assert tensor.size >= 60
    assert tensor.score(scene.truth) > 0.0


def test_one_seed_gives_one_tensor_on_any_number_of_threads() -> None:
    scene = p3p_scene(20, 30, noise=1.0, seed=3)
    allowed = numba.get_num_threads()
    tensors = []
    try:
        for threads in (1, allowed):
            numba.set_num_threads(threads)
            tensors.append(of_scene(scene, seed=7))
            assert tensors[-1].tensor.size  # evaluates the hyper-edges
    finally:
        numba.set_num_threads(allowed)
    (one, counted, *_), (other, recounted, *_) = tensors
    assert np.array_equal(one.indices, other.indices)
    assert np.array_equal(one.weights, other.weights)
    assert counted == recounted
    _, different, *_ = of_scene(scene, seed=8)
    assert different != counted


@pytest.mark.parametrize("name", SCENES)
def test_half_of_the_model_unseen_among_as_much_clutter(name: str) -> None:
    right = 0.0
    for seed in range(300, 308):
        scene = SCENES[name](10, 10, noise=0.5, seed=seed, hidden=10)
        tensor, *_ = of_scene(scene, seed=seed)
        right += scene.accuracy(MultiStartAscent()(tensor).assignment)
        assert tensor.score(scene.truth) >= 0.9 * true_information(scene)
    assert right >= 0.97 * 8


def test_more_points_than_hyperedges_can_be_kept() -> None:
    scene = p3p_scene(40, 10, noise=1.0, seed=2)
    options = Guided(subsets=3000, edges=5000)
    found = of_scene(scene, options=options)
    tensor, share = found.tensor, found.share
    assert share <= 3000 / math.comb(40, 4) * 1.01
    assert tensor.size <= 5000
    assert tensor.score(scene.truth) == pytest.approx(share * true_information(scene), rel=0.1)
    assert scene.accuracy(MultiStartAscent()(tensor).assignment) >= 0.95


def test_a_symmetric_object_is_proposed_both_ways() -> None:
    rng = np.random.default_rng(0)
    half = rng.uniform(-2.0, 2.0, (6, 3))
    points = np.concatenate([half, half * [-1.0, -1.0, 1.0]])  # half a turn about z
    partner = np.concatenate([np.arange(6, 12), np.arange(6)])
    both = 0
    for seed in range(6):
        scene = p3p_scene(12, 12, noise=0.5, seed=seed)
        ((R, t),) = scene.poses
        pixels = scene.target.copy()
        pixels[scene.truth] = scene.cameras[0].project(points @ R.T + t) + rng.normal(0.0, 0.5, (12, 2))
        tensor, *_ = search(scene.problem, points, pixels, 0.5, seed=seed)
        straight, turned = tensor.score(scene.truth), tensor.score(scene.truth[partner])
        both += min(straight, turned) > 0.8 * max(straight, turned) > 0.3 * math.comb(12, 4)
    assert both == 6


def test_chance_is_the_mean_weight_of_random_hyperedges() -> None:
    scene = up2p_scene(12, 12, noise=8.0, seed=1)
    chance = np.mean([of_scene(scene, seed=seed).chance for seed in range(16)])
    tables = scene.problem.prepare(scene.source, scene.target, scene.noise)
    source, target = next(enumeration.random_hyperedges(12, 24, 3, 200_000, seed=99, block=200_000))
    residuals = cpu.residuals(tables, WEIGH.residual.kernel_kind(3), source, target)
    weights = np.where(residuals <= WEIGH.gate, np.exp(-0.5 * residuals**2), 0.0)
    # four standard errors: 15 % of the mean here, for 16 searches of 4096 random hyper-edges
    error = 4.0 * weights.std() / math.sqrt(16 * CHANCE_SAMPLES)
    assert error < 0.2 * weights.mean()
    assert chance == pytest.approx(weights.mean(), abs=error)


class NoTables(tuple):
    """Tables of a problem without any kernels."""

    @staticmethod
    def kernels() -> ProblemKernels:
        return ProblemKernels()


def test_it_pays_beyond_a_few_million_hyperedges() -> None:
    scene = p3p_scene(20, 20)
    kind = WEIGH.residual.kernel_kind(6)
    tables = scene.problem.prepare(scene.source, scene.target)
    assert not pays(SamplingTask(tables, kind, WEIGH, (10, 10), 4))
    request = SamplingTask(tables, kind, WEIGH, (10, 20), 4)
    assert pays(request)
    assert not pays(replace(request, motions=2))
    assert pays(replace(request, motions=2, shape=(20, 20)))
    assert not pays(replace(request, candidates=np.eye(10, 20, dtype=bool)))
    assert not pays(replace(request, tables=NoTables(), shape=(20, 40)))


def test_two_motions_are_both_proposed() -> None:
    scene = p3p_scene(16, noise=0.5, seed=11, motions=2)
    tensor, *_ = of_scene(scene, motions=2, options=Guided(budget=20_000_000))
    for motion in (0, 1):
        alone = np.where(scene.motions == motion, scene.truth, -1)
        assert tensor.score(alone) >= 0.2 * math.comb(8, 4)


def test_the_search_ends_when_all_motions_are_beyond_chance() -> None:
    scene = p3p_scene(40, noise=0.5, seed=1, motions=2)
    tensor, evaluated, *_ = of_scene(scene, motions=2)
    assert evaluated < 0.2 * Guided().budget
    for motion in (0, 1):
        alone = np.where(scene.motions == motion, scene.truth, -1)
        assert tensor.score(alone) >= 0.02 * math.comb(20, 4)


def test_forbidden_correspondences_are_never_tried() -> None:
    scene = p3p_scene(10, 10, noise=1.0, seed=6)
    rng = np.random.default_rng(0)
    allowed = rng.random((10, 20)) < 0.3
    allowed[np.arange(10), scene.truth] = True
    tensor, evaluated, *_ = of_scene(scene, candidates=allowed)
    assert allowed.ravel()[tensor.indices].all()
    assert tensor.score(scene.truth) >= 0.95 * true_information(scene)
    _, without, *_ = of_scene(scene)
    assert evaluated < without
    allowed[:] = False
    tensor, evaluated, *_ = of_scene(scene, candidates=allowed)
    assert tensor.size == 0
    assert evaluated == 0


@pytest.mark.parametrize("view", range(4))
def test_headset_of_which_most_is_unseen(view: int, load_shared: Callable[[str], dict[str, NDArray]]) -> None:
    data = load_shared("vive_hmd_lighthouse")
    seen = np.random.default_rng(view).permutation(np.flatnonzero(np.isfinite(data["points2d"][view, :, 0])))
    truth = np.full(32, -1)
    truth[seen] = np.arange(len(seen))
    order = enumeration.farthest_point_order(data["points3d"])
    tensor, *_ = search(
        P3P(Camera.from_matrix(data["K"][view])),
        data["points3d"][order],
        data["points2d"][view][seen],
        noise=0.15,
        normals=data["normals3d"][order],
    )
    assert np.array_equal(MultiStartAscent()(tensor).assignment[truth[order] >= 0], truth[order][truth[order] >= 0])


def test_exact_points_and_few_points() -> None:
    for make, n, extra, noise in ((p3p_scene, 10, 5, 0.0), (p3p_scene, 4, 0, 0.5), (up2p_scene, 3, 1, 0.1)):
        scene = make(n, extra, noise=noise, seed=1)
        tensor, *_ = of_scene(scene)
        assert tensor.score(scene.truth) >= 0.95 * true_information(scene)
        assert tensor.size > 0


def test_the_budget_ends_the_search_and_progress_is_told() -> None:
    rng = np.random.default_rng(0)
    problem = p3p_scene().problem
    source, target = rng.uniform(-2, 2, (12, 3)), rng.uniform(0, 480, (12, 2))
    told: list[tuple[int, int]] = []
    _, evaluated, *_ = search(
        problem, source, target, options=Guided(budget=200_000), progress=lambda *done: told.append(done)
    )
    assert 200_000 <= evaluated < 2_000_000
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert told[-1] == (200_000, 200_000)
    _, soon, *_ = search(problem, source, target, options=Guided(max_seconds=0.0))
    assert soon < evaluated


def test_what_is_found_by_the_batch_that_spends_the_budget_ends_the_search() -> None:
    """A sweep of all hyper-edges follows a search that found nothing."""
    scene, told = p3p_scene(20, 8, seed=3), list[int]()
    assert of_scene(scene, progress=lambda done, _: told.append(done)).conclusive
    assert len(told) > 2  # the last one is told at the end
    assert of_scene(scene, options=Guided(budget=told[-2] - 1)).conclusive
    assert not of_scene(scene, options=Guided(budget=told[-3] - 1)).conclusive


def test_options_of_the_parts_reach_them() -> None:
    scene = p3p_scene(10, 10, seed=3)
    usual = of_scene(scene)
    assert usual.conclusive
    assert usual.evaluated < 200_000
    never = of_scene(scene, options=Guided(budget=200_000, stopping=StoppingOptions(beyond_chance=1e6)))
    assert not never.conclusive
    assert never.evaluated >= 200_000


def test_every_minimal_set_comes_once_where_there_are_few() -> None:
    rng = np.random.default_rng(3)
    places = rng.normal(size=(11, 3))
    waves = list(minimal_sets(places, 3, rng))
    listed = np.concatenate(waves)
    assert [len(wave) for wave in waves[:4]] == [8, 16, 32, 64]
    assert sorted(map(tuple, listed.tolist())) == list(combinations(range(11), 3))
    assert width(places, waves[0]).min() > np.median(width(places, listed))
    many = minimal_sets(rng.normal(size=(60, 3)), 3, rng)
    for _ in range(20):
        wave = next(many)
        assert (np.diff(wave, axis=1) > 0).all()
    assert len(wave) == 128


def test_width_is_the_least_altitude_or_the_distance() -> None:
    places = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0], [8.0, 0.0, 0.0]])
    # 3-4-5: altitude on the longest side 12/5; three points on a line: none
    assert width(places, np.array([[0, 1, 2], [0, 1, 3]])) == pytest.approx([2.4, 0.0])
    assert width(places, np.array([[1, 2], [0, 3]])) == pytest.approx([5.0, 8.0])
    rng = np.random.default_rng(0)
    chosen = widest_sets(rng.normal(size=(30, 3)), np.arange(3, 25), 3, 5, rng)
    assert chosen.shape == (5, 3)
    assert 3 <= chosen.min() <= chosen.max() < 25
    assert remaining_points(np.array([[1, 3], [0, 2]]), 4).tolist() == [[0, 2], [1, 3]]


def test_mistakes_are_said() -> None:
    with pytest.raises(InputError, match="Guided: budget is 0; give a whole number above 0"):
        Guided(budget=0)
    with pytest.raises(InputError, match=r"StoppingOptions: complete is 1\.5; give a number above 0 and of at most 1"):
        StoppingOptions(complete=1.5)
    scene = p3p_scene(6)

    with pytest.raises(InputError, match="no hypotheses to guide"):
        Guided()(SamplingTask(NoTables(), WEIGH.residual.kernel_kind(6), WEIGH, (6, 6), 4))
    assert scene.truth.size == 6


def test_all_are_evaluated_where_a_quick_search_is_not_trusted() -> None:
    scene = up2p_scene(10, 2, noise=0.5, seed=3)
    everything = enumeration.exhaustive_count(10, 12, 3)
    found = match(scene.source, scene.target, scene.problem, noise=0.5)
    assert np.array_equal(found.assignment, scene.truth)
    assert found.evaluated < everything / 10
    unrelated = np.random.default_rng(1).uniform(0.0, 480.0, (12, 2))
    refused = match(scene.source, unrelated, scene.problem, noise=0.5)
    assert refused.status is Status.UNTRUSTED
    assert refused.evaluated > everything
    swept = match(scene.source, unrelated, scene.problem, noise=0.5, sampler="exhaustive")
    assert np.array_equal(refused.assignment, swept.assignment)


def test_the_gate_is_narrower_where_detections_crowd() -> None:
    rng = np.random.default_rng(0)
    factors = []
    for count in (10, 60, 2000):
        pixels = rng.uniform((0.0, 0.0), (640.0, 480.0), (count, 2))
        factors.append(gate_factor(Camera(1000.0, 1000.0, 320.0, 240.0).bearings(pixels).T, 0.008))
    assert factors[0] == 1.0 > factors[1] > factors[2] == NARROWEST


def test_chance_ends_no_search_in_part_of_the_images() -> None:
    """Of five points, of which chance matches all, one minimal set is enough; a pose with four needs most of them."""
    rng = np.random.default_rng(0)
    points, target = 0.05 * rng.normal(size=(5, 3)), rng.uniform(0.0, 1000.0, (24, 2))
    problem, found = P3P(Camera(900.0, 900.0, 500.0, 500.0)), []
    for in_part in (False, True):
        options = Guided(budget=100_000_000, stopping=StoppingOptions(in_part=in_part))
        found.append(search(problem, points, target, 4.0, options=options))
    assert max((one >= 0).sum() for one in found[0].assignments) == 5
    assert found[1].evaluated > 3 * found[0].evaluated
    assert found[1].missed < 0.05


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("in_part", [False, True])
def test_what_shares_no_detection_with_the_best_is_handed_on(seed: int, in_part: bool) -> None:
    """Seven points of a body tell a pose; five of a copy may be chance, which the model of the image weighs."""
    camera, options = Camera(900.0, 900.0, 640.0, 480.0), Guided(stopping=StoppingOptions(in_part=in_part))
    rng = np.random.default_rng(seed)
    body, turns = rng.uniform(-0.5, 0.5, (7, 3)), Rotation.random(2, rng=rng).as_matrix()
    first = camera.project(body @ turns[0].T + (-1.5, 0.0, 8.0))
    second = camera.project(body[:5] @ turns[1].T + (1.5, 0.0, 8.0))
    target = np.concatenate([first, second]) + rng.normal(0.0, 0.3, (12, 2))
    told = search(P3P(camera), body, target, 0.3, options=options).assignments
    assert sum(not np.isin(one[one >= 0], told[0]).any() for one in told) == 1


def test_a_second_place_is_found_although_the_first_explains_all_points() -> None:
    # no pose explains more: a search that ended for that met 14 of these 20
    camera, met = Camera(900.0, 900.0, 640.0, 480.0), 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        body, seen = rng.uniform(-0.5, 0.5, (6, 3)), []
        for x in (-1.5, 1.5):
            R = Rotation.random(random_state=rng).as_matrix()
            seen.append(camera.project(body @ R.T + (x, 0.0, rng.uniform(6.0, 9.0))))
        clutter = rng.uniform((100.0, 100.0), (1180.0, 860.0), (3, 2))
        target = np.concatenate([seen[0], seen[1][1:], clutter]) + rng.normal(0.0, 1.0, (14, 2))
        told = match(body, target, P3P(camera), noise=1.0, seed=seed)
        named = [told.assignment, *(other for other, _ in told.alternatives)]
        met += any(np.array_equal(one, [-1, *range(6, 11)]) for one in named)
    assert met >= 18


@pytest.mark.parametrize("clutter", [6, 9])
def test_a_few_strays_leave_no_doubt_about_a_regular_body(clutter: int) -> None:
    """Lights in pairs look like themselves; that a rival has more detections than there are strays is no doubt."""
    camera, missed = Camera(1500.0, 1500.0, 960.0, 540.0), []
    pairs = np.column_stack([np.repeat(60.0 * np.arange(12.0), 2), np.tile([-20.0, 20.0], 12), np.zeros(24)])
    for seed in range(6):
        rng = np.random.default_rng(seed)
        lights = pairs + rng.normal(0.0, 0.1, pairs.shape)
        pitch = rng.uniform(0.3, 0.5)
        ahead = np.array([math.cos(pitch), 0.0, -math.sin(pitch)])
        right = np.array([0.0, -1.0, 0.0])
        R = np.stack([right, np.cross(ahead, right), ahead])
        position = np.array([rng.uniform(100.0, 300.0), rng.uniform(-30.0, 30.0), 120.0])
        seen = (lights - position) @ R.T
        ahead_of = np.flatnonzero(seen[:, 2] > 100.0)[:9]
        target = np.concatenate(
            [camera.project(seen[ahead_of]), rng.uniform((0.0, 0.0), (1920.0, 1080.0), (clutter, 2))]
        )
        missed.append(search(P3P(camera), lights, target + rng.normal(0.0, 0.4, target.shape), 0.4).missed)
    assert max(missed) <= 0.05
