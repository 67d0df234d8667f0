"""The cases of `record.py`: every problem and every feature of the public interface, on small fixed scenes.

A case is a name, ``family-seed``, and a function that makes a match, or those of the frames of a sequence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import record_scenes as scenes
from record_scenes import Scene

import rootmatch as rm


class Frame(NamedTuple):
    """The match of one frame of a sequence, and what else is recorded of it."""

    number: int
    match: rm.Match
    states: str = ""


Case = tuple[str, Callable[[], rm.Match | list[Frame]]]

DOWN = (0, 1, 0)
CAMERA = rm.Camera(scenes.FOCAL, scenes.FOCAL, *scenes.CENTRE.tolist())
P3P, UP2P = rm.P3P(CAMERA), rm.UP2P(CAMERA, DOWN, DOWN)
BETWEEN, PLANAR = rm.ThreePlusOne(CAMERA, axis=DOWN, axis2=DOWN), rm.PlanarMotion(CAMERA, axis=DOWN)
K = [[scenes.WIDE, 0.0, 320.0], [0.0, scenes.WIDE, 240.0], [0.0, 0.0, 1.0]]
LONG = 3600.0
"""Seconds that are enough for anything: a deadline that is never reached."""
UPRIGHT = {"upright": True}


def run(name: str, scene: Scene, problem: rm.Problem, **options: Any) -> Case:
    """One match."""
    return name, lambda: rm.match(scene["source"], scene["target"], problem, **options)


def sequence(
    name: str, make: Callable[[], rm.Matcher], frames: Sequence[Any], options: Sequence[dict[str, Any]] = ()
) -> Case:
    """A match of each frame by one `Matcher`."""

    def matches() -> list[Frame]:
        matcher = make()
        each = options or [{}] * len(frames)
        return [Frame(k, matcher.match(frame, **each[k])) for k, frame in enumerate(frames)]

    return name, matches


def tracked(name: str, make: Callable[[], rm.Tracker], frames: Sequence[Any], **options: Any) -> Case:
    """A match of each frame by one `Tracker`, with what it says of the bodies then."""

    def matches() -> list[Frame]:
        tracker, out = make(), []
        for k, frame in enumerate(frames):
            match = tracker.update(frame, **options)
            out.append(Frame(k, match, ",".join(state.name for state in tracker.states.values())))
        return out

    return name, matches


def predicted(scene: Scene, seed: int, body: int = 0, deviation: float = 0.02, off: float = 1.0) -> rm.Pose:
    """A prediction of a body's pose, ``off`` times as wrong as it says."""
    R, t = scene["poses"][body]
    error = deviation * off * np.random.default_rng([seed, body, 3]).normal(size=6)
    return rm.Pose(scenes.turned(error[:3]) @ R, t + error[3:], np.eye(6) * deviation**2)


@cache
def derived() -> rm.Problem:
    """Planar motion derived again from its equation."""
    import sympy as sp

    x, tx, tz = sp.symbols("x tx tz")
    turn = sp.Matrix([[1 - x**2, 0, 2 * x], [0, 1 + x**2, 0], [-2 * x, 0, 1 - x**2]])
    move = sp.Matrix([tx, 0, tz])
    return rm.derive(
        "floor", each=lambda p, q: q.dot(move.cross(turn * p)), minimal=2, shared=x, eliminate=[tx, tz],
        source=rm.Bearings(CAMERA), target=rm.Bearings(CAMERA),
    )  # fmt: skip


def the_rig(sizes: bool = False) -> rm.Rig:
    """The cameras of `record_scenes.rig`."""
    camera = rm.Camera(scenes.WIDE, scenes.WIDE, *scenes.CENTRE.tolist())
    views = [(camera, R, t) for R, t in scenes.rig_views()]
    return rm.Rig(views, sizes=[tuple(scenes.SIZE.tolist())] * len(views)) if sizes else rm.Rig(views)


def cases() -> Iterator[Case]:
    """All of them."""
    yield from plain()
    yield from priors()
    yield from several_bodies()
    yield from rigs()
    yield from sequences()
    yield from cameras()
    yield from large()
    yield from weights()
    yield from deadlines()


def plain() -> Iterator[Case]:
    """One match each: problems, searches, motions, solvers, noise."""
    absolute, views, flat = scenes.absolute, scenes.views, scenes.flat
    for s in range(20):
        yield run(f"p3p-8+4-{s}", absolute(100 + s, 8, 4, 0.5), P3P, noise=0.5)
        yield run(f"up2p-8+6-{s}", absolute(200 + s, 8, 6, 0.5, **UPRIGHT), UP2P, noise=0.5)
        yield run(f"3p1-8+2-{s}", views(300 + s, 8, 2, 0.3, 2.0), BETWEEN, noise=0.3)
    for s in range(15):
        yield run(f"p3p-guided-16+16-{s}", absolute(400 + s, 16, 16, 0.5), P3P, noise=0.5)
        yield run(f"up2p-guided-60+60-{s}", absolute(500 + s, 60, 60, 0.5, **UPRIGHT), UP2P, noise=0.5)
        scene = absolute(600 + s, 9, 5, 0.5)
        yield run(f"p3p-normals-{s}", scene, P3P, noise=0.5, normals=scenes.unit(scene["source"]))
        scene = absolute(700 + s, 9, 5, 0.5, **UPRIGHT)
        mask = scene["rng"].random((9, 14)) < 0.9
        yield run(f"up2p-candidates-{s}", scene, UP2P, noise=0.5, candidates=mask)
        yield run(f"p3p-paper-{s}", absolute(800 + s, 8, 0, 0.1), P3P, preset="paper", samples=50_000, seed=s)
    for s in range(10):
        two = {**UPRIGHT, "motions": 2}
        yield run(f"up2p-motions-{s}", absolute(900 + s, 12, 4, 0.5, **two), UP2P, noise=0.5, motions=2)
        yield run(f"up2p-auto-motions-{s}", absolute(950 + s, 12, 0, 0.5, **two), UP2P, noise=0.5, motions="auto")
        yield run(f"p3p-auto-noise-{s}", absolute(1000 + s, 9, 0, 0.7), P3P, noise="auto")
        scene = absolute(1100 + s, 9, 3, 0.5, **UPRIGHT)
        yield run(f"up2p-noises-{s}", scene, UP2P, noise=scene["rng"].uniform(0.3, 0.9, 12))
        scene = absolute(1200 + s, 8, 3, 0.5, **UPRIGHT)
        yield run(f"up2p-normalised-{s}", scene, UP2P, noise=0.5, residual="normalised")
        small = rm.ThreePlusOne(CAMERA, small_baseline=1e-7, axis=(0, 1, 0), axis2=(0, 1, 0))
        yield run(f"3p1-baseline-{s}", views(1300 + s, 9, 2, 0.5, 0.3), small, noise=0.5)
        yield run(f"planar-{s}", views(1400 + s, 8, 0, 0.1, 1.0, planar=True), PLANAR, noise=0.1)
        yield run(
            f"up2pf-{s}",
            absolute(1500 + s, 7, 1, 0.3, **UPRIGHT),
            rm.UP2PF((320.0, 240.0), (0, 1, 0), (0, 1, 0)),
            noise=0.3,
        )
        yield run(f"similarity-{s}", flat(1600 + s, 12, 4, 0.01, 2, 2.5), rm.Similarity(2), noise=0.01)
        yield run(f"rigid-{s}", flat(1700 + s, 12, 4, 0.01, 3, 1.0), rm.Rigid(3), noise=0.01)
        scene = absolute(1800 + s, 9, 0, 0.5)
        yield run(f"p3p-random-{s}", scene, P3P, noise=0.5, sampler="random", samples=200_000)
    for s in range(5):
        yield run(f"p3p-motions-{s}", absolute(1900 + s, 14, 0, 0.3, motions=2), P3P, noise=0.3, motions=2)
        for k, solver in enumerate(("rrwhm", "bcagm", "hgm")):
            yield run(f"p3p-{solver}-{s}", absolute(2000 + 50 * k + s, 8, 2, 0.5), P3P, noise=0.5, solver=solver)
        scene = absolute(2200 + s, 8, 6, 0.5)
        yield sequence(
            f"p3p-matcher-{s}", lambda scene=scene: rm.Matcher(scene["source"], P3P, noise=0.5), [scene["target"]]
        )
        scene = views(2300 + s, 8, 0, 0.1, 1.0, planar=True)
        yield f"derived-{s}", lambda scene=scene: rm.match(scene["source"], scene["target"], derived(), noise=0.1)
    for s in range(13):
        yield run(f"up2p-unrelated-{s}", absolute(2400 + s, 3, 12, 0.5), UP2P, noise=0.5)
        unrelated = {**absolute(2500 + s, 8, 0, 0.5), "target": absolute(2600 + s, 9, 0, 0.5)["target"]}
        yield run(f"p3p-unrelated-{s}", unrelated, P3P, noise=0.5)


def priors() -> Iterator[Case]:
    """A predicted pose: right, wrong, vague, of few points."""
    noise = 0.3
    for s in range(6):
        one = scenes.bodies(3000 + s, [scenes.shape(s, 8)], 4)
        yield run(f"prior-{s}", one, P3P, noise=noise, prior=predicted(one, s))
        yield run(f"prior-wrong-{s}", one, P3P, noise=noise, prior=predicted(one, s, off=25.0))
    for s in range(4):
        one = scenes.bodies(3100 + s, [scenes.shape(s, 8)], 4)
        yield run(f"prior-vague-{s}", one, P3P, noise=noise, prior=predicted(one, s, deviation=0.2))
        yield run(f"prior-noises-{s}", one, P3P, noise=one["rng"].uniform(0.2, 0.5, 12), prior=predicted(one, s))
        few = scenes.bodies(3200 + s, [scenes.shape(s, 3)], 1)
        few["source"] = np.vstack([few["source"], scenes.shape(90 + s, 4)])
        yield run(f"prior-few-{s}", few, P3P, noise=noise, prior=predicted(few, s, deviation=0.005))
        nothing = {**one, "target": one["rng"].uniform((0, 0), (640, 480), (9, 2))}
        yield run(f"prior-nothing-{s}", nothing, P3P, noise=noise, prior=predicted(one, s))
        upright = scenes.bodies(3300 + s, [scenes.shape(s, 8)], 4, **UPRIGHT)
        yield run(f"prior-up2p-{s}", upright, UP2P, noise=noise, prior=predicted(upright, s))
        sided = scenes.surface(3400 + s, 24, 4)
        yield run(
            f"prior-normals-{s}", sided, P3P, noise=0.4, normals=sided["normals"], view_angle=np.radians(75.0),
            detection_rate=0.9, prior=predicted(sided, s),
        )  # fmt: skip
    for s in range(2):
        one = scenes.bodies(3250 + s, [scenes.shape(s, 8)], 4)
        yield run(f"prior-off-{s}", one, P3P, noise=noise, prior=predicted(one, s, off=4.0))
        alike = scenes.bodies(3270 + s, [scenes.symmetric(s)], 1, sigma=0.5)
        yield run(f"p3p-symmetric-{s}", alike, P3P, noise=0.5)
        yield run(f"prior-symmetric-{s}", alike, P3P, noise=0.5, prior=predicted(alike, s, deviation=0.1))
        yield run(f"prior-symmetric-vague-{s}", alike, P3P, noise=0.5, prior=predicted(alike, s, deviation=0.6))
        upright = scenes.bodies(3350 + s, [scenes.shape(s, 8)], 4, **UPRIGHT)
        yield run(f"prior-up2p-wrong-{s}", upright, UP2P, noise=noise, prior=predicted(upright, s, off=25.0))


def several_bodies() -> Iterator[Case]:
    """Bodies with labels: seen or not, alike, predicted, with candidates."""
    noise = 0.3

    def case(name: str, scene: Scene, problem: rm.Problem = P3P, **more: Any) -> Case:
        return run(name, scene, problem, noise=noise, bodies=scene["labels"], **more)

    for s in range(5):
        two = scenes.bodies(3500 + s, [scenes.shape(s), scenes.shape(50 + s)], 3)
        yield case(f"bodies-{s}", two)
        prior = {label: predicted(two, s, k) for k, label in enumerate(("head", "left"))}
        yield case(f"bodies-priors-{s}", two, prior=prior)
    for s in range(3):
        shapes = [scenes.shape(10 + s), scenes.shape(60 + s)]
        two = scenes.bodies(3600 + s, shapes, 4, seen=[True, False])
        yield case(f"bodies-hidden-{s}", two)
        yield case(f"bodies-hidden-prior-{s}", two, prior={"left": predicted(two, s, 1)})
        two = scenes.bodies(3700 + s, shapes, 3)
        yield case(f"bodies-one-prior-{s}", two, prior={"head": predicted(two, s)})
        yield case(f"bodies-wrong-prior-{s}", two, prior={"head": predicted(two, s, off=25.0)})
        mask = two["rng"].random((14, 17)) < 0.9
        yield case(f"bodies-candidates-{s}", two, candidates=mask)
        yield case(f"bodies-weights-{s}", two, candidates=mask * two["rng"].uniform(0.5, 1.0, mask.shape))
        mirrored = shapes[0] * [-1.0, 1.0, 1.0]
        yield case(f"bodies-mirror-{s}", scenes.bodies(3800 + s, [shapes[0], mirrored], 2, distance=12.0))
        far = scenes.bodies(3850 + s, [shapes[0], mirrored], 0, distance=12.0, seen=[True, False])
        yield case(f"bodies-mirror-far-{s}", far)
        upright = scenes.bodies(3900 + s, shapes, 3, **UPRIGHT)
        yield case(f"bodies-up2p-{s}", upright, UP2P)
        three = scenes.bodies(4000 + s, [*shapes, scenes.shape(160 + s, 9)], 3)
        yield case(f"bodies-three-{s}", three)
        normals = np.vstack([scenes.unit(part) for part in shapes])
        yield case(f"bodies-normals-{s}", two, normals=normals, view_angle=np.radians(180.0))


def rigs() -> Iterator[Case]:
    """Several cameras on one body."""
    noise = 0.5
    p3p, sized = rm.P3P(the_rig()), rm.P3P(the_rig(sizes=True))
    for s in range(4):
        one = scenes.rig(4100 + s, [scenes.shape(s, 20, 1.0)], 5, 2)
        yield run(f"rig-{s}", one, p3p, noise=noise)
        yield run(f"rig-prior-{s}", one, p3p, noise=noise, prior=predicted(one, s, deviation=0.01))
    for s in range(2):
        one = scenes.rig(4200 + s, [scenes.shape(10 + s, 20, 1.0)], 6, 2)
        yield run(f"rig-sizes-{s}", one, sized, noise=noise)
        yield run(f"rig-sizes-prior-{s}", one, sized, noise=noise, prior=predicted(one, s, deviation=0.01))
        yield run(f"rig-wrong-prior-{s}", one, p3p, noise=noise, prior=predicted(one, s, deviation=0.01, off=30.0))
        yield run(f"rig-guided-{s}", one, p3p, noise=noise, sampler=rm.Guided())
        yield run(f"rig-all-seen-{s}", scenes.rig(4300 + s, [scenes.shape(s, 8)], None, 2), p3p, noise=noise)
        unrelated = {**one, "source": scenes.shape(300 + s, 20, 1.0)}
        yield run(f"rig-unrelated-{s}", unrelated, p3p, noise=noise)
        two = scenes.rig(4400 + s, [scenes.shape(s, 7), scenes.shape(50 + s, 7)], None, 2)
        prior = {label: predicted(two, s, k, deviation=0.01) for k, label in enumerate(("left", "right"))}
        yield run(f"rig-bodies-{s}", two, p3p, noise=noise, bodies=two["labels"])
        yield run(f"rig-bodies-priors-{s}", two, p3p, noise=noise, bodies=two["labels"], prior=prior)
        del prior["right"]
        yield run(f"rig-bodies-one-prior-{s}", two, p3p, noise=noise, bodies=two["labels"], prior=prior)
        sided = scenes.unit(one["source"])
        yield run(
            f"rig-normals-{s}", one, p3p, noise=noise, normals=sided, view_angle=np.radians(180.0), detection_rate=0.8
        )


def sequences() -> Iterator[Case]:
    """`Matcher` and `Tracker` over some frames."""
    noise = 0.3
    two = [scenes.shape(70), scenes.shape(71)]
    labels = ["head"] * 7 + ["left"] * 7
    joined = np.vstack(two)
    for s in range(2):
        one = scenes.shape(80 + s)
        frames = scenes.flight(4500 + s, 8, [one])
        yield tracked(f"tracker-{s}", lambda one=one: rm.Tracker(one, P3P, noise=noise), frames)
        hidden = scenes.flight(4600 + s, 12, [one], hidden=(4, 5, 6))
        yield tracked(f"tracker-hidden-{s}", lambda one=one: rm.Tracker(one, P3P, noise=noise), hidden)
        jump = scenes.flight(4700 + s, 9, [one], jump=4)
        yield tracked(f"tracker-jump-{s}", lambda one=one: rm.Tracker(one, P3P, noise=noise), jump)
        upright = scenes.flight(4800 + s, 6, [one], **UPRIGHT)
        yield tracked(f"tracker-up2p-{s}", lambda one=one: rm.Tracker(one, UP2P, noise=noise), upright)
        both = scenes.flight(4900 + s, 6, two)
        yield tracked(f"tracker-bodies-{s}", lambda: rm.Tracker(joined, P3P, noise=noise, bodies=labels), both)
        path = [scenes.flown(k / scenes.RATE, 4950 + s, [0.0, 0.0, 0.0]) for k in range(5)]
        one_rig = [scenes.rig([4950 + s, k], [one], None, 1, poses=[pose])["target"] for k, pose in enumerate(path)]  # type: ignore[arg-type]
        yield tracked(f"tracker-rig-{s}", lambda one=one: rm.Tracker(one, rm.P3P(the_rig()), noise=noise), one_rig)
        yield tracked(
            f"tracker-noises-{s}", lambda one=one: rm.Tracker(one, P3P, noise=noise), frames, noise=np.full(9, 0.4)
        )
        yield sequence(f"matcher-{s}", lambda one=one: rm.Matcher(one, P3P, noise=noise), frames[:4])
        yield sequence(f"matcher-rig-{s}", lambda one=one: rm.Matcher(one, rm.P3P(the_rig()), noise=noise), one_rig[:2])
        yield sequence(f"matcher-bodies-{s}", lambda: rm.Matcher(joined, P3P, noise=noise, bodies=labels), both[:3])
        yield sequence(f"matcher-up2p-{s}", lambda one=one: rm.Matcher(one, UP2P, noise=noise), upright[:3])
        made = [scenes.bodies(5000 + 10 * s + k, [one], 3) for k in range(3)]
        each = [{"prior": predicted(scene, k), "noise": np.full(10, 0.35)} for k, scene in enumerate(made)]
        yield sequence(
            f"matcher-priors-{s}", lambda one=one: rm.Matcher(one, P3P, noise=noise), [m["target"] for m in made], each
        )
        faulty = [np.empty((0, 2)), made[0]["target"][:2], made[0]["target"][[0, 1, 2, 3, 4, 0]], made[0]["target"]]
        yield sequence(f"matcher-faults-{s}", lambda one=one: rm.Matcher(one, P3P, noise=noise), faulty)
        yield sequence(
            f"matcher-bodies-faults-{s}",
            lambda: rm.Matcher(joined, P3P, noise=noise, bodies=labels),
            [*faulty[:2], both[0]],
        )
        pair = scenes.views(5100 + s, 8, 2, 0.3, 2.0)
        yield sequence(
            f"matcher-3p1-{s}",
            lambda pair=pair: rm.Matcher(pair["source"], BETWEEN, noise=noise),
            [pair["target"], pair["target"][1:]],
        )
        sets = scenes.flat(5200 + s, 10, 3, 0.01, 3, 1.0)
        yield sequence(f"matcher-rigid-{s}", lambda sets=sets: rm.Matcher(sets["source"], rm.Rigid(3), noise=0.01),
                       [sets["target"], sets["target"][2:]])  # fmt: skip
    points = scenes.surface(5300, 20, 0)
    seen = scenes.flight(5300, 6, [points["source"] * 0.4], normals=points["normals"])

    def sided() -> rm.Tracker:
        more = {"normals": points["normals"], "view_angle": np.radians(70.0), "detection_rate": 0.9}
        return rm.Tracker(points["source"] * 0.4, P3P, noise=noise, **more)

    yield tracked("tracker-normals-0", sided, seen)
    more = {"normals": points["normals"], "view_angle": np.radians(70.0)}
    yield sequence("matcher-normals-0", lambda: rm.Matcher(points["source"] * 0.4, P3P, noise=noise, **more), seen[:3])
    alike = scenes.symmetric(7)
    yield tracked("tracker-symmetric-0", lambda: rm.Tracker(alike, P3P, noise=noise), scenes.flight(5350, 8, [alike]))
    gone = scenes.flight(5400, 6, two, hidden=(3,))
    yield tracked("tracker-bodies-hidden-0", lambda: rm.Tracker(joined, P3P, noise=noise, bodies=labels), gone)
    empty = [*scenes.flight(5500, 2, [two[0]]), np.empty((0, 2)), *scenes.flight(5500, 4, [two[0]])[2:]]
    yield tracked("tracker-empty-0", lambda: rm.Tracker(two[0], P3P, noise=noise), empty)


def cameras() -> Iterator[Case]:
    """Lenses, unit rays, the vertical with its noise, and what is visible."""
    brown = rm.Camera.from_opencv(K, list(scenes.BROWN))
    fisheye = rm.Camera.from_opencv_fisheye(K, list(scenes.FISHEYE))
    rays = rm.Bearings()
    for s in range(3):
        kinds = [("brown", brown, scenes.brown, 0.4), ("fisheye", fisheye, scenes.fisheye, 0.4)]
        for k, (name, camera, project, sigma) in enumerate([*kinds, ("rays", rays, scenes.unit, 1e-3)]):
            seed = 5600 + 20 * k + s
            yield run(f"p3p-{name}-{s}", scenes.wide(seed, 9, 4, sigma, project), rm.P3P(camera), noise=sigma)
            upright = scenes.wide(seed + 5, 9, 4, sigma, project, **UPRIGHT)
            yield run(f"up2p-{name}-{s}", upright, rm.UP2P(camera, (0, 1, 0), (0, 1, 0)), noise=sigma)
            pair = scenes.views(seed + 10, 8, 1, 0.3, 2.0)
            source, target = (scenes.unit(one) if name == "rays" else project(one) for one in pair["seen"])
            noisy = {"source": source, "target": target[pair["rng"].permutation(8)]}
            yield run(f"3p1-{name}-{s}", noisy, rm.ThreePlusOne(camera, axis=(0, 1, 0), axis2=(0, 1, 0)), noise=sigma)
        tilted = rm.UP2P(CAMERA, (0, 1, 0), (0, 1, 0), vertical_noise=0.01)
        yield run(f"up2p-tilted-{s}", scenes.absolute(5700 + s, 9, 4, 0.5, **UPRIGHT), tilted, noise=0.5)
        tilted = rm.ThreePlusOne(CAMERA, axis=DOWN, axis2=DOWN, axis_noise=0.005)
        yield run(f"3p1-tilted-{s}", scenes.views(5710 + s, 9, 1, 0.3, 2.0), tilted, noise=0.3)
        sided = scenes.surface(5800 + s, 30, 4)
        normals = {"noise": 0.4, "normals": sided["normals"]}
        yield run(f"p3p-view-angle-{s}", sided, P3P, view_angle=np.radians(75.0), **normals)
        each = sided["rng"].uniform(75.0, 90.0, 30)
        yield run(f"p3p-view-angles-{s}", sided, P3P, view_angle=np.radians(each), **normals)
        yield run(f"p3p-detection-{s}", sided, P3P, detection_rate=0.9, **normals)
        yield run(
            f"p3p-view-angle-detection-{s}", sided, P3P, view_angle=np.radians(75.0), detection_rate=0.9, **normals
        )
        yield run(f"p3p-rate-alone-{s}", scenes.absolute(5900 + s, 8, 4, 0.5), P3P, noise=0.5, detection_rate=0.95)


def large() -> Iterator[Case]:
    """Local triples (50 points and more), views, two images, point sets, and proposed pairs."""
    for s in range(3):
        many = scenes.surface(6000 + s, 60, 8)
        yield run(f"local-triples-{s}", many, P3P, noise=0.4)
        yield run(
            f"local-weights-{s}",
            many,
            P3P,
            noise=0.4,
            candidates=many["rng"].uniform(0.5, 1.0, (60, len(many["target"]))),
        )
        yield run(f"visible-triples-{s}", many, P3P, noise=0.4, normals=many["normals"], view_angle=np.radians(75.0))
        yield run(f"3p1-guided-{s}", scenes.views(6100 + s, 30, 8, 0.3, 2.0), BETWEEN, noise=0.3)
        floor = scenes.views(6200 + s, 24, 4, 0.1, 1.0, planar=True)
        yield run(f"planar-guided-{s}", floor, PLANAR, noise=0.1)
        two_sets = scenes.flat(6300 + s, 40, 15, 0.01, 3, 1.0)
        yield run(f"rigid-guided-{s}", two_sets, rm.Rigid(3), noise=0.01)
        yield run(f"rigid-source-noise-{s}", two_sets, rm.Rigid(3), noise=0.01, source_noise=0.005)
        yield run(f"similarity-guided-{s}", scenes.flat(6400 + s, 40, 15, 0.01, 2, 2.0), rm.Similarity(2), noise=0.01)
        yield run(f"similarity-space-{s}", scenes.flat(6500 + s, 10, 3, 0.01, 3, 2.0), rm.Similarity(3), noise=0.01)
        flipped = scenes.flat(6600 + s, 10, 3, 0.01, 3, 1.0)
        flipped["target"] = flipped["target"] * [-1.0, 1.0, 1.0]
        yield run(f"similarity-mirror-{s}", flipped, rm.Similarity(3, mirror=True), noise=0.01)
        yield run(f"rigid-plane-{s}", scenes.flat(6700 + s, 10, 3, 0.01, 2, 1.0), rm.Rigid(2), noise=0.01)
    for s in range(2):
        pairs = scenes.proposed(6800 + s, 200)
        for motions in (2, "auto"):
            yield run(f"proposed-{motions}-{s}", pairs, P3P, noise=1.0, candidates=pairs["mask"], motions=motions)
        upright = scenes.proposed(6900 + s, 200, **UPRIGHT)
        yield run(f"proposed-up2p-{s}", upright, UP2P, noise=1.0, candidates=upright["mask"], motions="auto")
        false = {**pairs, "mask": pairs["mask"][:, pairs["rng"].permutation(200)]}
        yield run(f"proposed-false-{s}", false, P3P, noise=1.0, candidates=false["mask"], motions="auto")


def weights() -> Iterator[Case]:
    """Weights of candidates."""

    def weighed(scene: Scene) -> Any:
        shape = len(scene["source"]), len(scene["target"])
        return (scene["rng"].random(shape) < 0.9) * scene["rng"].uniform(0.3, 1.0, shape)

    for s in range(3):
        one = scenes.absolute(7000 + s, 8, 4, 0.5)
        yield run(f"p3p-weights-{s}", one, P3P, noise=0.5, candidates=weighed(one))
        one = scenes.absolute(7100 + s, 9, 5, 0.5, **UPRIGHT)
        yield run(f"up2p-weights-{s}", one, UP2P, noise=0.5, candidates=weighed(one))
        one = scenes.absolute(7200 + s, 16, 16, 0.5)
        yield run(f"p3p-guided-weights-{s}", one, P3P, noise=0.5, candidates=weighed(one))
        one = scenes.views(7300 + s, 8, 2, 0.3, 2.0)
        yield run(f"3p1-weights-{s}", one, BETWEEN, noise=0.3, candidates=weighed(one))
        one = scenes.bodies(7400 + s, [scenes.shape(s, 8)], 4)
        yield run(f"prior-weights-{s}", one, P3P, noise=0.3, candidates=weighed(one), prior=predicted(one, s))
        yield run(f"prior-mask-{s}", one, P3P, noise=0.3, candidates=weighed(one) > 0.0, prior=predicted(one, s))
        one = scenes.rig(7500 + s, [scenes.shape(s, 8)], None, 2)
        if s == 0:
            yield run(f"rig-weights-{s}", one, rm.P3P(the_rig()), noise=0.5, candidates=weighed(one))


def deadlines() -> Iterator[Case]:
    """``max_seconds=`` that is never reached: what it changes by being there."""
    for s in range(2):
        soon = {"noise": 0.5, "max_seconds": LONG}
        yield run(f"seconds-p3p-{s}", scenes.absolute(7600 + s, 8, 4, 0.5), P3P, **soon)
        yield run(f"seconds-guided-{s}", scenes.absolute(7610 + s, 16, 16, 0.5), P3P, **soon)
        yield run(f"seconds-up2p-{s}", scenes.absolute(7620 + s, 20, 20, 0.5, **UPRIGHT), UP2P, **soon)
        both = scenes.absolute(7630 + s, 12, 0, 0.5, upright=True, motions=2)
        yield run(f"seconds-motions-{s}", both, UP2P, motions=2, **soon)
        two = scenes.bodies(7640 + s, [scenes.shape(s), scenes.shape(50 + s)], 3)
        yield run(f"seconds-bodies-{s}", two, P3P, bodies=two["labels"], **soon)
        yield run(f"seconds-prior-{s}", two, P3P, bodies=two["labels"], prior={"left": predicted(two, s, 1)}, **soon)
        one = scenes.rig(7650 + s, [scenes.shape(s, 20, 1.0)], 5, 2)
        yield run(f"seconds-rig-{s}", one, rm.P3P(the_rig()), **soon)
        many = scenes.surface(7660 + s, 60, 6)
        yield run(f"seconds-local-{s}", many, P3P, **soon)
        yield run(
            f"seconds-rigid-{s}", scenes.flat(7670 + s, 12, 4, 0.01, 3, 1.0), rm.Rigid(3), noise=0.01, max_seconds=LONG
        )
        frames = scenes.flight(7680 + s, 4, [scenes.shape(s)])
        yield tracked(
            f"seconds-tracker-{s}", lambda s=s: rm.Tracker(scenes.shape(s), P3P, noise=0.3, max_seconds=LONG), frames
        )
