"""Every feature × every other one: both hold together, or one clear error says that they do not go together.

`FEATURES` is the table. Each pair is asked for on one small and easy scene, in which all of them can be combined; what
is asked for is that features go together, not how far either goes. What is refused is listed in `REFUSED`, what fails
in `FAILS` with the reason: a pair that begins to hold, or to fail, is noticed. The crossings below the table are those
in which a feature must change the answer.
"""

from __future__ import annotations

import inspect
import itertools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

import rootmatch as rm

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
SIGMA, SIGMA_IN_SPACE = 0.3, 0.002
CAMERA = rm.Camera(1000.0, 1000.0, 320.0, 240.0)
RIG = [(CAMERA, np.eye(3), np.array([x, 0.0, 0.0])) for x in (-0.3, 0.0, 0.3)]
SIZES = [(640.0, 480.0)] * len(RIG)
LABELS = ("head", "left")
COUNT, CLUTTER, FRAMES = 7, 2, 3
FRAME_OPTIONS = ("candidates", "prior", "noise")
"""What belongs to one frame of a sequence."""


class Frame(NamedTuple):
    """Detections and the truth: an index (n,), or with a rig (C, n)."""

    target: Floats
    truth: Integers


class World:
    """Points, problem and frames that suit some features."""

    def __init__(self, features: frozenset[str]) -> None:
        self.features = features
        self.is_rig, self.in_space = "rig" in features, "Rigid" in features
        rng = np.random.default_rng(5)
        self.shapes = [rng.uniform(-0.35, 0.35, (COUNT, 3)) for _ in range(2 if "bodies" in features else 1)]
        self.poses = [
            (about_y(rng.uniform(-3.0, 3.0)), np.array([0.6 * k - 0.3 * (len(self.shapes) - 1), 0.1, 4.0]))
            for k in range(len(self.shapes))
        ]
        self.source = np.vstack(self.shapes)
        self.rig = rm.Rig(RIG)
        self.sigma = SIGMA_IN_SPACE if self.in_space else SIGMA
        self.frames = [self.frame(k) for k in range(FRAMES)]
        if "empty frame" in features:
            nothing = np.full_like(self.frames[-1].truth, -1)
            self.frames[-1] = Frame(np.empty((0, self.frames[-1].target.shape[1])), nothing)

    @property
    def problem(self) -> rm.Problem:
        """The problem, and its camera."""
        if self.in_space:
            return rm.Rigid(3)
        camera = self.rig if self.is_rig else CAMERA
        return rm.UP2P(camera, (0, 1, 0), (0, 1, 0)) if "UP2P" in self.features else rm.P3P(camera)

    def frame(self, k: int) -> Frame:
        """One frame: the same poses, other noise, clutter and order."""
        rng = np.random.default_rng([6, k])
        placed = np.vstack([X @ R.T + t for X, (R, t) in zip(self.shapes, self.poses, strict=True)])
        n = len(placed)
        if self.in_space:
            images = [np.vstack([placed, rng.uniform((-1, -1, 3), (1, 1, 5), (CLUTTER, 3))])]
        else:
            offsets = [t for _, _, t in RIG] if self.is_rig else [np.zeros(3)]
            images = [
                np.vstack([CAMERA.project(placed + t), rng.uniform((0, 0), (640, 480), (CLUTTER, 2))]) for t in offsets
            ]
        images = [image + self.sigma * rng.normal(size=image.shape) for image in images]
        rows = [np.column_stack([image, np.full(len(image), c)]) for c, image in enumerate(images)]
        every = np.vstack(rows if self.is_rig else images)
        order = rng.permutation(len(every))
        place = np.argsort(order)
        truth = np.array([place[c * (n + CLUTTER) : c * (n + CLUTTER) + n] for c in range(len(images))])
        return Frame(every[order], truth if self.is_rig else truth[0])

    def pose(self, body: int = 0, off: float = 1.0, deviation: float = 0.01) -> rm.Pose:
        """A prediction of a body's pose, ``off`` times as wrong as it says."""
        R, t = self.poses[body]
        return rm.Pose(R, t + off * deviation * np.array([0.5, -0.4, 0.6]), np.eye(6) * deviation**2)

    def turn(self, body: int = 0) -> rm.PosePrior:
        """A rotation of a body that is known to two degrees."""
        return rm.PosePrior(rotation=(self.poses[body][0] @ about_y(0.03), math.radians(2.0)))

    def options(self, k: int) -> dict[str, Any]:
        """What the features ask for in frame k."""
        target, truth = self.frames[k]
        n, n_target = len(self.source), len(target)
        rng = np.random.default_rng(7)
        given: dict[str, Any] = {"noise": self.sigma}
        unlikely = rng.random((n, n_target)) < 0.1
        for one in np.atleast_2d(truth):
            unlikely[np.flatnonzero(one >= 0), one[one >= 0]] = False
        towards = np.vstack(
            [np.broadcast_to(-R.T @ t, X.shape) for X, (R, t) in zip(self.shapes, self.poses, strict=True)]
        )
        made: dict[str, Callable[[], dict[str, Any]]] = {
            "weights": lambda: {"candidates": np.where(unlikely, 0.5, 1.0)},
            "candidates": lambda: {"candidates": ~unlikely},
            "bodies": lambda: {"bodies": np.repeat(LABELS, COUNT)},
            "prior": lambda: {
                "prior": {label: self.pose(b) for b, label in enumerate(LABELS)}
                if "bodies" in self.features
                else self.pose()
            },
            "PosePrior": lambda: {
                "prior": {label: self.turn(b) for b, label in enumerate(LABELS)}
                if "bodies" in self.features
                else self.turn()
            },
            "noises": lambda: {"noise": self.sigma * rng.uniform(0.9, 1.2, n_target)},
            "auto noise": lambda: {"noise": "auto"},
            "max_seconds": lambda: {"max_seconds": 600.0},
            "normals": lambda: {"normals": towards},
            "view_angle": lambda: {"normals": towards, "view_angle": math.radians(80.0)},
            "detection_rate": lambda: {"detection_rate": 0.9},
            "resolution": lambda: {"resolution": 1.0},
            "source_noise": lambda: {"source_noise": 0.002},
            "Guided": lambda: {"sampler": rm.Guided()},
        }
        for name in self.features & made.keys():
            given |= made[name]()
        return given

    def answer(self, **changes: Any) -> rm.Match:
        """The match of the last frame, by the call that the features ask for, with some options changed."""
        if not self.features & {"Matcher", "Tracker", "empty frame"}:
            return rm.match(
                self.source, self.frames[-1].target, self.problem, **{**self.options(FRAMES - 1), **changes}
            )
        tracked = "Tracker" in self.features
        called = rm.Tracker if tracked else rm.Matcher
        first = {**self.options(0), **changes}
        follows = rm.Tracker.update if tracked else rm.Matcher.match
        of_frame = set(FRAME_OPTIONS) & set(inspect.signature(follows).parameters)
        if isinstance(first["noise"], str):
            of_frame.discard("noise")
        one = called(self.source, self.problem, **{name: first[name] for name in first.keys() - of_frame})
        for k, frame in enumerate(self.frames):
            given = {name: value for name, value in {**self.options(k), **changes}.items() if name in of_frame}
            match = follows(one, frame.target, **given)  # type: ignore[arg-type]
        if tracked and "empty frame" not in self.features:
            assert all(state is rm.TrackingState.TRACKING for state in one.states.values())  # type: ignore[union-attr]
        return match


def about_y(angle: float) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def holds_right(world: World, match: rm.Match) -> None:
    """What every match of a frame with detections keeps: it is right and says so."""
    found = match.sightings.assignment if world.is_rig and match.sightings is not None else match.assignment
    assert match
    np.testing.assert_array_equal(found, world.frames[-1].truth)
    assert match.probability is None or 0.5 < match.probability <= 1.0


def holds_empty(world: World, match: rm.Match) -> None:
    """And of one without."""
    assert not match
    assert match.status is rm.Status.UNTRUSTED
    assert match.assignment.shape == (len(world.source),)
    assert (match.assignment == -1).all()
    assert match.pairs.shape == (0, 2)
    assert "no detections" in match.advice


def holds_bodies(world: World, match: rm.Match) -> None:
    assert match.bodies is not None
    assert list(match.bodies) == list(LABELS)
    for k, body in enumerate(match.bodies.values()):
        np.testing.assert_array_equal(body.assignment, match.assignment[k * COUNT : (k + 1) * COUNT])


def holds_rig(world: World, match: rm.Match) -> None:
    assert match.sightings is not None
    assert match.sightings.assignment.shape == (len(RIG), len(world.source))


def holds_prior(world: World, match: rm.Match) -> None:
    if "empty frame" in world.features:
        return
    each = [match] if match.bodies is None else match.bodies.values()
    assert [one.prior_holds for one in each] == [True] * len(world.shapes)


def holds_estimate(world: World, match: rm.Match) -> None:
    if "empty frame" not in world.features:
        # beside a noise of the model it is what that leaves, of exact points nothing
        assert match.noise < 2.5 * world.sigma
        assert "source_noise" in world.features or match.noise > 0.4 * world.sigma


def holds_time(world: World, match: rm.Match) -> None:
    assert not match.stopped_early


def holds_candidates(world: World, match: rm.Match) -> None:
    allowed = world.options(FRAMES - 1)["candidates"]
    assert (allowed[tuple(match.pairs.T)] > 0).all()


class Feature(NamedTuple):
    """A feature; features of one group exclude each other."""

    group: str
    holds: Callable[[World, rm.Match], None] | None = None


FEATURES: dict[str, Feature] = {
    "UP2P": Feature("geometry"),
    "Rigid": Feature("point sets"),
    "rig": Feature("camera", holds_rig),
    "Matcher": Feature("call"),
    "Tracker": Feature("call"),
    "empty frame": Feature("frame", holds_empty),
    "bodies": Feature("bodies", holds_bodies),
    "prior": Feature("prior", holds_prior),
    "PosePrior": Feature("prior", holds_prior),
    "weights": Feature("candidates", holds_candidates),
    "candidates": Feature("candidates", holds_candidates),
    "noises": Feature("noise"),
    "auto noise": Feature("noise", holds_estimate),
    "max_seconds": Feature("time", holds_time),
    "normals": Feature("normals"),
    "view_angle": Feature("normals"),
    "detection_rate": Feature("rate"),
    "resolution": Feature("blobs"),
    "source_noise": Feature("model"),
    "Guided": Feature("sampler"),
}
POINT_SETS = frozenset({"UP2P", "rig"})
"""What is no question beside two point sets, which have no camera."""

TRIPLES = [
    ("rig", "bodies", "prior"),
    ("rig", "bodies", "Tracker"),
    ("rig", "bodies", "Matcher"),
    ("rig", "bodies", "empty frame"),
    ("rig", "Tracker", "empty frame"),
    ("rig", "Tracker", "noises"),
    ("bodies", "Tracker", "empty frame"),
    ("bodies", "Tracker", "noises"),
    ("bodies", "prior", "weights"),
    ("bodies", "prior", "UP2P"),
    ("bodies", "Tracker", "UP2P"),
    ("bodies", "Tracker", "normals"),
    ("bodies", "Tracker", "max_seconds"),
    ("source_noise", "rig", "Tracker"),
    ("UP2P", "rig", "Tracker"),
    ("UP2P", "rig", "bodies"),
    ("UP2P", "rig", "prior"),
    ("PosePrior", "rig", "bodies"),
    ("PosePrior", "bodies", "Tracker"),
    ("source_noise", "rig", "bodies"),
    ("source_noise", "bodies", "Tracker"),
]
"""Where two features meet in a third one."""

REFUSED: dict[tuple[str, ...], str] = {
    ("Rigid", "normals"): "normals: rigid cannot use them",
    ("Rigid", "view_angle"): "normals: rigid cannot use them",
    ("Rigid", "resolution"): "resolution: rigid has no camera",
    ("bodies", "auto noise"): 'noise: "auto" cannot be estimated from several bodies',
    ("Tracker", "auto noise"): "noise: 'auto' given; a tracker needs",
}
"""Features that do not go together, and how the error begins that says so."""

FAILS: dict[tuple[str, ...], str] = {}
"""What does not hold yet, and why."""


def fails(reason: str) -> pytest.MarkDecorator:
    """The mark of what is known not to hold: it must fail by what it asserts, and it is told when it holds."""
    return pytest.mark.xfail(strict=True, reason=reason, raises=(AssertionError, pytest.fail.Exception))


def asked(features: tuple[str, ...]) -> Any:
    """One question, marked if it is known to fail."""
    marks = [fails(FAILS[features])] if features in FAILS else []
    return pytest.param(features, marks=marks, id=" x ".join(features))


def pairs() -> list[tuple[str, ...]]:
    """Every pair that is a question."""
    return [
        (one, other)
        for one, other in itertools.combinations(FEATURES, 2)
        if FEATURES[one].group != FEATURES[other].group and not ("Rigid" in (one, other) and POINT_SETS & {one, other})
    ]


@pytest.mark.parametrize("features", [asked(one) for one in [*pairs(), *TRIPLES]])
def test_features_hold_together_or_are_refused(features: tuple[str, ...]) -> None:
    world = World(frozenset(features))
    if features in REFUSED:
        with pytest.raises(rm.InputError, match=REFUSED[features]) as refused:
            world.answer()
        text = str(refused.value)
        assert ": " in text
        assert "\n" not in text
        return
    match = world.answer()
    if "empty frame" not in features:
        holds_right(world, match)
    for name in features:
        holds = FEATURES[name].holds
        if holds is not None:
            holds(world, match)


# A feature that has no effect is no feature: it is refused, or it changes what is told.

CONTEXTS: dict[str, tuple[str, ...]] = {
    "alone": (),
    "UP2P": ("UP2P",),
    "Rigid": ("Rigid",),
    "rig": ("rig",),
    "bodies": ("bodies",),
    "prior": ("prior",),
    "bodies and priors": ("bodies", "prior"),
    "rig and prior": ("rig", "prior"),
    "Matcher": ("Matcher",),
    "Tracker": ("Tracker",),
}
NOISE_IGNORED: dict[str, str] = {}
RATE_IGNORED: dict[str, str] = {}
"""Where an argument is taken and changes nothing, and why."""


def known(name: str, failing: dict[str, str]) -> Any:
    """One case, marked if it is known to fail."""
    return pytest.param(name, marks=[fails(failing[name])] if name in failing else [])


def told(match: rm.Match) -> str:
    """What a match says of itself and its poses, NaN like NaN."""
    every = [match] if match.bodies is None else list(match.bodies.values())
    poses = [pose for one in every for pose in one.poses]
    covariances = [None if pose is None or pose.covariance is None else pose.covariance.tolist() for pose in poses]
    return repr((match.log_odds, match.probability, match.confidence.tolist(), match.score, covariances))


@pytest.mark.parametrize("context", [known(name, NOISE_IGNORED) for name in CONTEXTS])
def test_the_noise_of_each_detection_counts(context: str) -> None:
    world = World(frozenset({*CONTEXTS[context], "noises"}))
    n_target = len(world.frames[-1].target)
    once, twice = (
        world.answer(noise=world.sigma * np.random.default_rng(1).uniform(1.0, 1.5, n_target) * factor)
        for factor in (1.0, 1.3)
    )
    assert told(once) != told(twice)


@pytest.mark.parametrize("context", [known(name, RATE_IGNORED) for name in CONTEXTS])
def test_the_detection_rate_counts(context: str) -> None:
    world = World(frozenset(CONTEXTS[context]))
    high, low = (world.answer(detection_rate=rate) for rate in (0.95, 0.6))
    assert told(high) != told(low)


@pytest.mark.parametrize("context", CONTEXTS)
def test_the_noise_of_each_source_point_counts(context: str) -> None:
    world = World(frozenset(CONTEXTS[context]))
    none, some = (world.answer(source_noise=sigma) for sigma in (None, 0.004))
    assert told(none) != told(some)
    assert some.pose is None or none.pose is None or np.trace(some.pose.covariance) > np.trace(none.pose.covariance)


# Of two detections that the pose cannot tell apart, the weights of `candidates=` choose one.


def of_two(features: tuple[str, ...], chosen: int) -> tuple[rm.Match, list[int]]:
    """The match where point 0 has two detections a pixel apart, the chosen one a hundred times as likely; those two."""
    world = World(frozenset({*features, "weights"}))
    first = []
    for k, frame in enumerate(world.frames):
        truth = np.atleast_2d(frame.truth)
        again = frame.target[truth[:, 0]].copy()
        again[:, 0] += world.sigma * 2.0
        frame.target[truth[:, 0], 0] -= world.sigma
        world.frames[k] = Frame(np.vstack([frame.target, again]), frame.truth)
        first = [int(truth[0, 0]), len(frame.target)]
    weights = np.ones((len(world.source), len(world.frames[-1].target)))
    weights[0, first] = [1.0, 1e-4] if chosen == 0 else [1e-4, 1.0]
    return world.answer(candidates=weights), first


WEIGHED = ["alone", "UP2P", "bodies", "prior", "bodies and priors", "Matcher"]


@pytest.mark.parametrize(
    "context",
    WEIGHED,
)
def test_weights_choose_between_detections(context: str) -> None:
    for chosen in (0, 1):
        match, two = of_two(CONTEXTS[context], chosen)
        assert match.assignment[0] == two[chosen]
        assert match.confidence[0] > 0.9


def test_a_wrong_prior_of_one_body_is_told() -> None:
    world = World(frozenset({"bodies"}))
    prior = {"head": world.pose(0), "left": world.pose(1, off=60.0)}
    match = rm.match(world.source, world.frames[0].target, world.problem, noise=SIGMA, bodies=np.repeat(LABELS, COUNT),
                     prior=prior)  # fmt: skip
    np.testing.assert_array_equal(match.assignment, world.frames[0].truth)
    assert match.bodies is not None
    assert match.bodies["head"].prior_holds is True
    assert match.bodies["left"].prior_holds is False
    assert "this pose contradicts the prior, which was ignored" in match.bodies["left"].advice


# A rig whose images end: what lies outside of one is no evidence against a pose, on every path.

PATHS: dict[str, tuple[str, ...]] = {
    "search": ("rig",),
    "prior": ("rig", "prior"),
    "bodies": ("rig", "bodies"),
    "Matcher": ("rig", "Matcher"),
    "Tracker": ("rig", "Tracker"),
}


@pytest.mark.parametrize("path", PATHS)
def test_the_sizes_of_a_rigs_images_count(path: str) -> None:
    odds = []
    for sized in (False, True):
        world = World(frozenset(PATHS[path]))
        # the first image ends amidst the points
        width = float(np.median(world.frames[0].target[world.frames[0].truth[0], 0]))
        for k, frame in enumerate(world.frames):
            kept = (frame.target[:, 2] > 0) | (frame.target[:, 0] < width)
            place = np.cumsum(kept) - 1
            world.frames[k] = Frame(frame.target[kept], np.where(kept[frame.truth], place[frame.truth], -1))
        assert (world.frames[-1].truth[0] < 0).any()
        world.rig = rm.Rig(RIG, sizes=[(width, 480.0), *SIZES[1:]] if sized else None)
        match = world.answer(detection_rate=0.97)
        assert match.sightings is not None
        np.testing.assert_array_equal(match.sightings.assignment, world.frames[-1].truth)
        assert match.log_odds is not None
        odds.append(match.log_odds)
    assert odds[1] > odds[0] + 0.5  # without sizes the missing points may all be beyond an edge


@pytest.mark.parametrize("path", ["search", "prior", "bodies"])
def test_clutter_of_one_image_is_no_clutter_of_another(path: str) -> None:
    odds = []
    for count in (0, 80):
        world = World(frozenset(PATHS[path]))
        rng = np.random.default_rng(9)
        for k, frame in enumerate(world.frames):
            kept = frame.target[:, 2] > 0  # the first camera is covered: it sees clutter alone
            place = np.cumsum(kept) - 1
            clutter = np.column_stack([rng.uniform((0, 0), (640, 480), (count + 2, 2)), np.zeros(count + 2)])
            seen = np.where(kept[frame.truth], place[frame.truth], -1)
            world.frames[k] = Frame(np.vstack([frame.target[kept], clutter]), seen)
        world.rig = rm.Rig(RIG, sizes=SIZES)
        match = world.answer()
        assert match.sightings is not None
        assert (match.sightings.assignment[1:] == world.frames[-1].truth[1:]).mean() > 0.9
        assert match.log_odds is not None
        odds.append(match.log_odds)
    assert abs(odds[1] - odds[0]) < 3.0


@pytest.mark.parametrize("context", ["alone", "bodies", "rig"])
def test_the_score_is_that_of_hyperedges_or_none(context: str) -> None:
    searched = World(frozenset(CONTEXTS[context])).answer()
    predicted = World(frozenset({*CONTEXTS[context], "prior"})).answer()
    assert predicted.evaluated == 0
    assert predicted.score is None
    assert searched.score is not None
    assert searched.score > 0.0


@pytest.mark.parametrize("context", ["alone", "bodies", "rig"])
def test_the_odds_against_clutter_have_one_unit(context: str) -> None:
    """A vague prior says little of the pose, so that the odds are nearly those of the same points without it.

    A rotation known to 0.2 rad is one of about 600, a place known to 0.2 one of about 500 in the room before a camera.
    """
    world = World(frozenset(CONTEXTS[context]))
    vague = [world.pose(k, deviation=0.2) for k in range(len(world.shapes))]
    searched = world.answer()
    predicted = world.answer(prior=dict(zip(LABELS, vague, strict=True)) if context == "bodies" else vague[0])
    assert predicted.evaluated == 0
    assert searched.log_odds is not None
    assert predicted.log_odds is not None
    gain = math.log(600.0 * 500.0)
    assert abs(predicted.log_odds - searched.log_odds) < 1.5 * gain * len(vague)


def test_guided_means_the_same_to_a_rig_as_to_one_camera() -> None:
    """The sampler that a caller gives is the one that is used: as the default, which is that with another budget."""
    world = World(frozenset({"rig"}))
    usual, given = world.answer(), world.answer(sampler=rm.Guided())
    np.testing.assert_array_equal(usual.confidence, given.confidence)
    assert usual.probability == given.probability
    assert usual.evaluated == given.evaluated
    assert [one.tolist() for one, _ in usual.alternatives] == [one.tolist() for one, _ in given.alternatives]


def test_a_match_is_true_if_it_can_be_believed() -> None:
    rng = np.random.default_rng(3)
    half = rng.uniform((0.1, -0.3, -0.3), (0.35, 0.3, 0.3), (4, 3))
    source = np.vstack([half, half * [-1.0, -1.0, 1.0]])  # the same after half a turn
    R, t = about_y(0.4), np.array([0.0, 0.1, 4.0])
    target = CAMERA.project(source @ R.T + t) + rng.normal(0.0, SIGMA, (8, 2))
    ambiguous = rm.match(source, target, rm.P3P(CAMERA), noise=SIGMA)
    assert ambiguous.status is rm.Status.AMBIGUOUS
    assert not ambiguous
    untrusted = rm.match(source, rng.uniform((0, 0), (640, 480), (9, 2)), rm.P3P(CAMERA), noise=SIGMA)
    assert untrusted.status is rm.Status.UNTRUSTED
    assert not untrusted
    assert World(frozenset()).answer()


@pytest.mark.parametrize("context", ["alone", "bodies", "rig", "prior"])
def test_a_match_of_no_detections_is_refused_once(context: str) -> None:
    world = World(frozenset(CONTEXTS[context]))
    with pytest.raises(rm.InputError, match="target: "):
        rm.match(world.source, np.empty((0, 3 if world.is_rig else 2)), world.problem, **world.options(0))


@pytest.mark.parametrize("context", CONTEXTS)
def test_a_deadline_that_is_over_ends_every_search(context: str) -> None:
    """It is told, unless a prediction decided within the moment that it may take beyond the deadline."""
    world = World(frozenset(CONTEXTS[context]))
    if "Tracker" in CONTEXTS[context]:
        match = rm.Tracker(world.source, world.problem, noise=SIGMA, max_seconds=1e-9).update(world.frames[0].target)
    else:
        match = world.answer(max_seconds=1e-9)
    assert match.evaluated == 0
    if "prior" in CONTEXTS[context] and match:
        return
    assert match.stopped_early
    assert not match
    assert "max_seconds" in match.advice
