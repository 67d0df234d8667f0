"""A deadline that passes at any moment: whenever that is, what was found is told, of every body."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch import matcher
from rootmatch.deadline import Deadline
from rootmatch.tracking import tracker

CAMERA = rm.Camera(640.0, 640.0, 640.0, 480.0, size=(1280, 960))
APART = (0.0, 0.3)
VIEWS = rm.Rig([(CAMERA, np.eye(3), np.array([-x, 0.0, 0.0])) for x in APART])
STRIDE = 5
"""Every moment is tried up to so many looks at the clock, and from there the later, the fewer."""
MAXIMUM = 4
"""Frames that a tracker has seen before."""


class Moment:
    """A clock that stands still until it was looked at so often, and then is so many seconds later."""

    def __init__(self, looks: float, late: float) -> None:
        self.left, self.late = looks, late

    def __call__(self) -> float:
        self.left -= 1
        return 0.0 if self.left >= 0 else self.late


def turned(k: int, body: int) -> NDArray[np.float64]:
    """The rotation of a body in a frame."""
    return Rotation.from_euler("xyz", [0.5 * math.sin(0.05 * k + body), 0.3 + body, 0.02 * k + 2.0 * body]).as_matrix()


def seen_in_space(rng: np.random.Generator, models: list[Any], k: int) -> Any:
    """Points of bodies side by side, with their noise, of which some are off, and three others.

    What is near a point without a match may be that of something alike, which takes longest to tell.
    """
    each = [model @ turned(k, body).T + (0.5 * body - 0.3 + 0.01 * k, 0.0, 2.0) for body, model in enumerate(models)]
    for one, off in zip(each, (0.02, 0.006), strict=False):
        one[k % len(one)] += off
    seen = np.concatenate([np.empty((0, 3)), *each])
    others = rng.uniform((-0.6, -0.5, 1.5), (0.6, 0.5, 2.5), (3, 3))
    return np.vstack([seen + rng.normal(0.0, 0.0005, seen.shape), others])


def scene(name: str) -> Callable[[], rm.Match]:
    """A match, or a tracker's frame, which begins anew whenever it is called."""
    rng = np.random.default_rng(132_000)
    models = [rng.uniform(-0.2, 0.2, (n, 3)) for n in ((6,) if "one" in name else (5, 6))]
    options: dict[str, Any] = {} if "one" in name else {"bodies": np.repeat([0, 1], (5, 6))}
    problem: Any = rm.Rigid() if "space" in name else rm.P3P(VIEWS) if "rig" in name else rm.P3P(CAMERA)

    def frame(k: int, shown: bool = True) -> tuple[Any, dict[str, Any]]:
        points, told = seen_in_space(rng, models if shown else [], k), dict[str, Any]()
        target: Any = points
        if "space" in name:
            told["noise"] = (0.0, np.tile(np.diag([1e-6, 1e-6, 3e-6]), (len(points), 1, 1)))
        elif "rig" in name:
            pixels = [CAMERA.project(points - (x, 0.0, 0.0)) for x in APART]
            target = np.concatenate(pixels), np.repeat([0, 1], [len(one) for one in pixels])
        else:
            target = CAMERA.project(points)
        if "rotation" in name:
            each = {k_: rm.PosePrior(rotation=(turned(k, k_), 0.03)) for k_ in range(len(models))}
            told["prior"] = each[0] if "one" in name else each
        return target, told

    noise: Any = (0.0, 0.001) if "space" in name else 0.4
    if "tracker" not in name:
        of_one = rm.Matcher(np.concatenate(models), problem, noise=noise, **options)
        target, told = frame(0)
        return lambda: of_one.match(target, max_seconds=600.0, **told)
    followed = rm.Tracker(np.concatenate(models), problem, noise=noise, **options)
    for k in range(1 if "lost" in name else MAXIMUM):
        target, told = frame(k, shown="lost" not in name)
        followed.update(target, time=k / 60, **told)
    state, (target, told) = pickle.dumps(followed), frame(MAXIMUM)
    return lambda: pickle.loads(state).update(target, time=MAXIMUM / 60, max_seconds=600.0, **told)


def is_whole(match: rm.Match) -> bool:
    """Whether a match tells all that it promises, and nothing that is no number."""
    odd = [not match.advice, match.noise_factor is not None and not math.isfinite(match.noise_factor)]
    if match.probability is not None:  # something was weighed
        odd += [not 0.0 <= match.probability <= 1.0, len(match.pairs) and np.isnan(match.confidence).any()]
    if match.pose is not None:
        odd.append(not (np.isfinite(match.pose.R).all() and np.isfinite(match.pose.t).all()))
    return not any(odd)


NAMES = (
    *("image", "image rotation", "image tracker", "image tracker lost", "image tracker rotation"),
    *("image tracker lost rotation", "rig", "rig tracker", "rig tracker lost", "space", "space tracker"),
    *("image one", "image one rotation", "image one tracker", "image one tracker lost", "space one", "rig one tracker"),
)


LATE = 1.0005, 1e6
"""Seconds at which time has been over for a moment, and for long; one look has the one, the next the other."""


@pytest.mark.parametrize("name", NAMES)
def test_whenever_time_is_over_all_bodies_are_told(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    match, looks, tried = scene(name), 0, 0
    whole = match()
    while True:
        clock = Moment(looks, LATE[tried % 2])
        for module in (matcher, tracker):
            monkeypatch.setattr(module, "Deadline", lambda *_, at=clock, **__: Deadline(1.0, started=0.0, clock=at))
        found = match()
        assert (found.bodies is None) == (whole.bodies is None), looks
        assert list(found.bodies or {}) == list(whole.bodies or {}), looks
        for one in [found, *(found.bodies or {}).values()]:
            assert is_whole(one), (looks, one)
        if clock.left >= 0:
            break
        looks, tried = looks + 1 + looks // STRIDE, tried + 1  # the later, the longer
    assert looks > 3
    assert not found.stopped_early
