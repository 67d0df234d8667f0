"""Calls of `rootmatch.match` as anybody may make them: recipes, what they stand for, and what must hold afterwards.

A recipe is a dictionary of plain values, so one that failed is kept as a JSON file and is a test from then on.
"""

from __future__ import annotations

import json
import math
import random
from collections.abc import Iterator
from typing import Any

import numpy as np

import rootmatch as rm
from rootmatch.report.json_record import match_record
from rootmatch.solvers import SOLVERS, Solution

CAMERA = rm.Camera(1000.0, 1000.0, 320.0, 240.0)
LENS = rm.Camera.from_opencv(CAMERA.matrix, [-0.2, 0.05, 0.001, -0.001])
FISHEYE = rm.Camera.from_opencv_fisheye(CAMERA.matrix, [0.02, -0.01, 0.001, 0.0])
PROBLEMS: dict[str, Any] = {
    "p3p": lambda: rm.P3P(CAMERA),
    "up2p": lambda: rm.UP2P(CAMERA, vertical_camera=(0.1, 1.0, 0.0), vertical_world=(0, 1, 0), vertical_noise=0.01),
    "3p1": lambda: rm.ThreePlusOne(CAMERA, axis=(0, 1, 0), axis2=(0, 1, 0)),
    "planar": lambda: rm.PlanarMotion(CAMERA, axis=(0, 1, 0)),
    "up2pf": lambda: rm.UP2PF((320.0, 240.0), (0, 1, 0), (0, 1, 0)),
    "similarity": lambda: rm.Similarity(2),
    "rigid": lambda: rm.Rigid(3),
    "p3p lens": lambda: rm.P3P(LENS),
    "up2p fisheye": lambda: rm.UP2P(FISHEYE, vertical_camera=(0.1, 1.0, 0.0), vertical_world=(0, 1, 0)),
}
SHAPES = (
    "scene", "scene", "scene", "unrelated", "collinear", "coplanar", "repeated", "nearly repeated", "behind", "on axis",
    "grid", "one depth", "vertical line",
)  # fmt: skip
DTYPES = (
    "float64", "float64", "float32", "longdouble", ">f8", "object", "float16", "int64", "int32", "uint8", "bool",
    "complex128", "str", "datetime64[s]",
)  # fmt: skip
HOLDERS = (
    "array", "array", "array", "fortran", "strided", "reversed", "list", "tuple", "read-only", "masked", "__array__",
    "nested", "matrix", "memoryview", "frame",
)  # fmt: skip
FAULTS = ("none",) * 12 + (
    "nan",
    "hidden",
    "inf",
    "huge",
    "flat",
    "wide",
    "deep",
    "scalar",
    "nothing",
    "text",
    "ragged",
    "empty",
)

OPTIONS: dict[str, tuple[Any, ...]] = {
    "noise": (0.5, 0.5, 0.5, 0, 1e-9, 1e-6, 100.0, 1e4, "auto", "each", "pair", "pairs", -1, math.nan, "x", None, []),
    "seed": (0, 1, 2**31, 2**63, 2**200, -1, 1.5),
    "preset": ("paper", "other"),
    "sampler": ("auto", "exhaustive", "random", "guided", "some", 3),
    "samples": (1, 50, 3000, 0, -5, 2.5, 10**12, 10**30),
    "residual": ("joint", "normalised", "qr", "qr-both", "svd", "l2", 5),
    "rho": (1.0, 1e-300, 1e-9, 1e300, 0.0, -1.0, math.inf, "x"),
    "solver": (*SOLVERS, "magic", 1),
    "motions": (1, 2, 3, "auto", 0, 50, 10**9, True, 2.5),
    "max_hyperedges": (1, 7, 1000, 0, 10**8, 10**15, 2.0),
    "max_evaluations": (1, 1000, 10**9, -1, "x"),
    "backend": ("cpu", "auto", "abacus"),
    "normals": ("toward", "random", "zero", "short", "nan", "text"),
    "candidates": (
        "all",
        "true",
        "few",
        "row",
        "column",
        "none",
        "one",
        "weights",
        "huge",
        "counts",
        "negative",
        "short",
    ),
    "progress": ("count", 3),
    "view_angle": (1.0, "each", 0.0, 3.2, math.nan, "x"),
    "detection_rate": (0.9, 1.0, 0.0, 1.5, math.nan, "x"),
    "resolution": (2.0, 1e6, 0.0, -1.0, math.nan, "x"),
    "bodies": ("one", "two", "all", "words", "short", "floats"),
    "prior": ("near", "far", "sharp", "singular", "none", "text"),
    "max_seconds": (0.01, 1.0, 1e300, 0.0, -1.0, math.nan, "x"),
}
"""Values of every option, usable ones and others, by a name where they depend on the points."""


SOUND: dict[str, tuple[Any, ...]] = {
    "noise": (0.5, 0, 1e-6, 100.0, "auto", "each"),
    "seed": (0, 1, 2**31),
    "preset": ("paper",),
    "sampler": ("auto", "exhaustive", "random", "guided"),
    "samples": (50, 3000),
    "residual": ("joint", "normalised", "qr", "qr-both", "svd"),
    "rho": (1.0, 1e-300, 1e-9, 1e300),
    "solver": tuple(SOLVERS),
    "motions": (1, 2, 3, "auto", 50),
    "max_hyperedges": (1, 7, 1000),
    "max_evaluations": (10**9,),
    "backend": ("cpu", "auto"),
    "normals": ("toward", "random", "zero"),
    "candidates": ("all", "true", "few", "row", "column", "one", "weights", "huge", "counts"),
    "progress": ("count",),
    "view_angle": (1.0, "each"),
    "detection_rate": (0.9, 0.5),
    "resolution": (2.0, 40.0, 1e6),
    "bodies": ("one", "two", "words"),
    "prior": ("near", "far", "sharp"),
    "max_seconds": (0.01, 1.0, 1e300),
}
"""Those that each are usable by themselves."""


def recipe(
    rng: random.Random, problems: tuple[str, ...] = tuple(PROBLEMS), **narrowed: tuple[Any, ...]
) -> dict[str, Any]:
    """A recipe of a call, of which about every second can be answered; ``narrowed`` gives fewer values of an option."""
    odd = rng.choice(("nothing", "nothing", "nothing", "options", "points", "all"))
    values = {**(OPTIONS if odd in ("options", "all") else SOUND), **narrowed}
    names = rng.sample(sorted(values), rng.randint(0, 4))
    odd_points = odd in ("points", "all")
    sides = {
        side: {
            "dtype": rng.choice(DTYPES if odd_points else DTYPES[:6]),
            "holder": rng.choice(HOLDERS),
            "fault": rng.choice(FAULTS) if odd_points else "none",
        }
        for side in ("source", "target")
    }
    return {
        "problem": rng.choice(problems),
        "shape": rng.choice(SHAPES),
        "points": rng.randint(0, 7) if odd_points else rng.randint(4, 7),
        "clutter": rng.randint(0, 3),
        "scale": rng.choice((0, -12, -6, -3, 3, 6, 12, *((60, -60, 120, -120) if odd_points else (0, 0)))),
        "offset": rng.choice((0.0, 0.0, 1e6, -1e12)),
        "seed": rng.randint(0, 999),
        **sides,
        "options": {name: rng.choice(values[name]) for name in names},
        "matcher": rng.random() < 0.5,
    }


def simpler(recipe: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Recipes with one thing less each."""
    for name in recipe["options"]:
        yield {**recipe, "options": {key: value for key, value in recipe["options"].items() if key != name}}
    plain = {"dtype": "float64", "holder": "array", "fault": "none"}
    for side in ("source", "target"):
        for key, value in plain.items():
            if recipe[side][key] != value:
                yield {**recipe, side: {**recipe[side], key: value}}
    for key, value in {"shape": "scene", "scale": 0, "offset": 0.0, "clutter": 0, "seed": 0, "matcher": False}.items():
        if recipe[key] != value:
            yield {**recipe, key: value}
    if recipe["points"] > 0:
        yield {**recipe, "points": recipe["points"] - 1}


def points_of(recipe: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Source and target as float64, before anything is done to them."""
    rng = np.random.default_rng(recipe["seed"])
    n, shape = recipe["points"], recipe["shape"]
    world = rng.uniform(-2.0, 2.0, (n, 3))
    if shape == "collinear":
        world = np.outer(np.arange(n), [1.0, 2.0, 0.5])
    elif shape == "coplanar":
        world[:, 2] = 0.0
    elif shape == "vertical line":
        world[:, [0, 2]] = 0.0
    elif shape == "grid":
        world = np.stack(np.unravel_index(np.arange(n), (3, 3, 1)), axis=1).astype(float)
    elif shape == "on axis":
        world[:, :2] = 0.0
    elif shape == "one depth":
        world[:, 2] = 1.0
    depth = -12.0 if shape == "behind" else 12.0
    views = world + np.array([0.0, 0.0, depth])
    image = CAMERA.project(views) + rng.normal(0.0, 0.3, (n, 2))
    if shape == "unrelated":
        image = rng.uniform(0.0, 480.0, (n, 2))
    image = np.concatenate([image, rng.uniform(0.0, 480.0, (recipe["clutter"], 2))])
    image = image[rng.permutation(len(image))]
    problem = PROBLEMS[recipe["problem"]]()
    if problem.source_dimension == 2:
        source = CAMERA.project(views + rng.normal(0.0, 1.0, 3)) if problem.name != "similarity" else world[:, :2]
    else:
        source = world
    if problem.target_dimension == 3:
        image = np.concatenate([world + 1.0, rng.uniform(-2.0, 2.0, (recipe["clutter"], 3))])
    if shape in ("repeated", "nearly repeated") and n > 1:
        source[1] = source[0] + (1e-12 if shape == "nearly repeated" else 0.0)
        if len(image) > 1:
            image[-1] = image[0] + (1e-12 if shape == "nearly repeated" else 0.0)
    return (source + recipe["offset"]) * 10.0 ** recipe["scale"], image


class Holder:
    """What is no array but gives one, as data frames and tensors of other libraries do."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = array

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return self.array if dtype is None else self.array.astype(dtype)


class Frame(Holder):
    """A stand-in for a data frame: it also has columns, a length and items by name."""

    columns = ("x", "y", "z")

    def __len__(self) -> int:
        return len(self.array)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.array[:, self.columns.index(name)]


def held(array: np.ndarray, how: dict[str, str]) -> Any:
    """An array with its fault, in its type and in what holds it."""
    array = np.array(array)
    fault = how["fault"]
    if fault in ("nan", "inf", "huge") and array.size:
        array[-1, 0] = {"nan": math.nan, "inf": -math.inf, "huge": 1e200}[fault]
    elif fault not in ("none", "nan", "inf", "huge", "hidden"):
        return {
            "flat": array.ravel(),
            "wide": np.hstack([array, array]),
            "deep": array[None],
            "scalar": 3.0,
            "nothing": None,
            "text": "points.csv",
            "ragged": [[0.0, 1.0], [2.0]],
            "empty": [],
        }[fault]
    with np.errstate(all="ignore"):
        if how["dtype"] == "datetime64[s]":
            typed = np.nan_to_num(array).clip(-1e9, 1e9).astype("int64").astype("datetime64[s]")
        elif np.dtype(how["dtype"]).kind in "iub":
            typed = np.nan_to_num(array).clip(-1e9, 1e9).astype("int64").astype(how["dtype"])
        else:
            typed = array.astype(how["dtype"])
    holder = how["holder"]
    if holder == "fortran":
        return np.asfortranarray(typed)
    if holder == "strided":
        return np.repeat(typed, 2, axis=0)[::2]
    if holder == "reversed":
        return np.ascontiguousarray(typed[::-1, ::-1])[::-1, ::-1]
    if holder == "list":
        return typed.tolist()
    if holder == "tuple":
        return tuple(map(tuple, typed.tolist()))
    if holder == "read-only":
        typed.flags.writeable = False
    elif holder == "masked" or fault == "hidden":
        hidden = np.zeros(typed.shape, bool)
        hidden[-1:] = fault == "hidden"
        return np.ma.array(typed, mask=hidden)
    elif holder == "__array__":
        return Holder(typed)
    elif holder == "frame":
        return Frame(typed)
    elif holder == "nested":
        return typed[:, None, :]
    elif holder == "matrix":
        return np.asmatrix(typed)
    elif holder == "memoryview" and typed.dtype.kind in "fiu" and typed.dtype.isnative and typed.itemsize <= 8:
        return memoryview(np.ascontiguousarray(typed))
    return typed


def option_of(name: str, value: Any, n: int, n_target: int, seed: int) -> Any:
    """The value of an option, where a name stands for one that depends on the points."""
    rng = np.random.default_rng(seed)
    if name == "noise":
        each = np.full(n_target, 0.5)
        return (
            {"each": each, "pair": (0.1, 0.5), "pairs": (np.full(n, 0.1), each)}.get(value, value)
            if isinstance(value, str)
            else value
        )
    if name == "normals":
        return {
            "toward": np.tile([0.0, 0.0, -1.0], (n, 1)),
            "random": rng.normal(size=(n, 3)),
            "zero": np.zeros((n, 3)),
            "short": np.ones((max(n - 1, 0), 3)),
            "nan": np.full((n, 3), math.nan),
            "text": "up",
        }[value]
    if name == "candidates":
        mask, weights = np.zeros((n, n_target), bool), rng.uniform(0.0, 5.0, (n, n_target))
        made: dict[str, Any] = {"all": ~mask, "none": mask, "weights": weights, "huge": weights * 1e200}
        made |= {"counts": weights.astype(int), "negative": weights - 2.0, "short": np.ones((n, n_target + 1))}
        made["true"] = rng.random((n, n_target)) < 0.6
        for key, index in (
            ("few", np.s_[:2, :2]),
            ("row", np.s_[:1]),
            ("column", np.s_[:, :1]),
            ("one", np.s_[:1, :1]),
        ):
            made[key] = mask.copy()
            made[key][index] = True
        return made[value]
    if name == "view_angle":
        return np.full(n, 1.3) if value == "each" else value
    if name == "bodies":
        labels: dict[str, Any] = {"one": np.zeros(n, int), "two": np.arange(n) % 2, "all": np.arange(n)}
        labels |= {"words": ["left" if k < n // 2 else "right" for k in range(n)], "floats": np.arange(n) / 2}
        return {**labels, "short": labels["one"][:-1]}[value]
    if name == "prior":
        spread = {"near": 1e-2, "far": 1.0, "sharp": 1e-12, "singular": 0.0}.get(value)
        if spread is None:
            return {"none": None, "text": "pose.csv"}[value]
        covariance = np.diag([spread**2] * 3 + [100.0 * spread**2] * 3)
        if value == "far":
            covariance[3:] = covariance[:, 3:] = 0.0
        return rm.Pose(np.eye(3), np.array([0.0, 0.0, 12.0]) + (5.0 if value == "sharp" else 0.0), covariance)
    if name == "progress" and value == "count":
        return lambda done, total: None
    return value


def attempt(recipe: dict[str, Any]) -> rm.Match | None:
    """Make the call and check what comes of it; None where it was refused by one `InputError`."""
    plain, plain_target = points_of(recipe)
    source, target = held(plain, recipe["source"]), held(plain_target, recipe["target"])
    before = [np.array(side) for side in (source, target) if isinstance(side, np.ndarray)]
    options = {
        name: option_of(name, value, len(plain), len(plain_target), recipe["seed"])
        for name, value in recipe["options"].items()
    }
    problem = PROBLEMS[recipe["problem"]]()
    try:
        if recipe["matcher"]:
            frame = {name: options.pop(name) for name in ("candidates", "prior", "max_seconds") if name in options}
            match = rm.Matcher(source, problem, **options).match(target, **frame)
        else:
            match = rm.match(source, target, problem, **options)
    except rm.InputError as error:
        check_text(str(error))
        return None
    for old, new in zip(before, (s for s in (source, target) if isinstance(s, np.ndarray)), strict=True):
        assert old.tobytes() == np.array(new).tobytes(), "an input was changed"
    check(match, options.get("candidates") if not recipe["matcher"] else frame.get("candidates"))
    return match


def check_text(text: str) -> None:
    """An error is one or two lines of text that nobody's terminal obeys."""
    assert 10 <= len(text) <= 1000, f"an error of {len(text)} characters"
    assert text.isprintable(), f"control characters: {text!r}"


def check_assignment(assignment: np.ndarray, n: int, n_target: int) -> None:
    """One-to-one, within range."""
    assert assignment.shape == (n,)
    assert assignment.dtype == np.int64
    matched = assignment[assignment >= 0]
    assert assignment.min(initial=-1) >= -1
    assert matched.max(initial=-1) < n_target
    assert len(np.unique(matched)) == len(matched), "two source points share a detection"


def check(match: rm.Match, candidates: Any = None) -> None:
    """What holds of every match, whatever it was given."""
    n, n_target = match.source.shape[0], match.target.shape[0]
    check_assignment(match.assignment, n, n_target)
    for other, score in match.alternatives:
        check_assignment(np.asarray(other), n, n_target)
        assert score is None or math.isfinite(score)
    assert match.score is not None or match.evaluated == 0 or match.bodies is not None
    assert match.score is None or (math.isfinite(match.score) and match.score >= 0.0)
    assert match.log_odds is None or not math.isnan(match.log_odds)
    assert bool(match) == (match.status is rm.Status.MATCHED)
    assert 0.0 <= match.margin <= 1.0
    assert match.soft_assignment.shape == (n, n_target)
    assert np.all(np.isfinite(match.soft_assignment))
    assert np.all(match.soft_assignment >= 0.0)
    assert np.array_equal(match.motion_labels >= 0, match.assignment >= 0)
    assert match.evaluated >= 0
    assert match.seconds >= 0.0
    assert np.all(np.isfinite(match.tensor.weights))
    if match.probability is not None:
        assert 0.0 <= match.probability <= 1.0
    if match.bodies is not None:
        check_bodies(match)
    elif match.status is rm.Status.MATCHED:
        # where a pose decides, every hyper-edge may be degenerate: a grid that faces a camera of unknown focal length
        assert match.finding.probability is not None or match.score is None or match.score > 0.0
        assert (match.assignment >= 0).any()
        assert len(match.pairs) == (match.assignment >= 0).sum()
        sure = match.margin >= 0.2 if match.finding.probability is None else match.finding.probability >= 0.9
        assert sure, "called matched against the rule"
    if candidates is not None:
        allowed = np.asarray(candidates) > 0
        matched = np.flatnonzero(match.assignment >= 0)
        assert allowed[matched, match.assignment[matched]].all(), "a correspondence that was excluded"
    check_text(match.advice)
    json.dumps(match_record(match), allow_nan=False)


def check_bodies(match: rm.Match) -> None:
    """Each body's match is one by itself, and the whole is as trustworthy as the least of them."""
    assert match.bodies is not None
    for own in match.bodies.values():
        check(own)
    statuses = {own.status for own in match.bodies.values()}
    assert (match.status is rm.Status.MATCHED) == (statuses == {rm.Status.MATCHED})


def nothing_found(tensor: rm.AffinityTensor, *, seed: int = 0) -> Solution:
    """A solver that finds nothing."""
    empty = np.full(tensor.shape[0], -1, np.int64)
    return Solution(np.zeros(tensor.shape), empty, 0.0, [], converged=True, iterations=0)
