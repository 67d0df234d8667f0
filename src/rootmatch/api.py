"""`match`, from the caller's points to a `Match`, and `residuals` of given hyper-edges."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.backends import cpu, selection
from rootmatch.backends.strongest import Progress
from rootmatch.deadline import Deadline
from rootmatch.errors import InputError
from rootmatch.explain.body_labels import Label
from rootmatch.explain.explain import explain
from rootmatch.explain.match_options import MatchOptions, SamplerName
from rootmatch.explain.prior_validation import Prior
from rootmatch.explain.task import MatchingTask
from rootmatch.explain.validation import check_indices
from rootmatch.hypergraph.affinity import Residual
from rootmatch.problems.base import Problem
from rootmatch.problems.capabilities import Capability
from rootmatch.problems.residual_dispatch import residual_kinds_of_tables
from rootmatch.result import Match, report
from rootmatch.samplers.base import Sampler
from rootmatch.solvers import Solver

__all__ = ["match", "residuals"]


def residuals(
    source: ArrayLike,
    target: ArrayLike,
    problem: Problem,
    source_index: ArrayLike,
    target_index: ArrayLike,
    kind: str | Residual = "joint",
    noise: ArrayLike = 1.0,
) -> NDArray[np.float64]:
    """Residuals (E,) of given hyper-edges.

    Parameters
    ----------
    source : (n, 3) or (n, 2) array
        Points in space, or pixels of the first image.
    target : (n', 2) array
        Pixels.
    problem : Problem
    source_index, target_index : (E, d) int arrays
        The d correspondences of each hyper-edge, no index twice within one.
    kind : str or Residual
        See `Residual`. ``"normalised"`` and ``"joint"`` are in units of ``noise``.
    noise : float or (n',) array
        σ of a pixel coordinate.

    Raises
    ------
    InputError
        If points or indices cannot be used.
    """
    if problem.rig is not None:
        raise InputError("residuals: a hyper-edge lies within one camera; give that camera instead of the rig")
    tables = problem.prepare(source, target, noise)
    n, n_target = len(np.asarray(source)), len(np.asarray(target))
    first = check_indices(source_index, n, problem.order, "source_index")
    second = check_indices(target_index, n_target, problem.order, "target_index")
    if first.shape != second.shape:
        raise InputError(
            f"source_index has shape {first.shape} and target_index {second.shape}; give the same shape, one "
            "hyper-edge a row"
        )
    chosen = kind if isinstance(kind, Residual) else Residual(kind)
    kernel_kind = chosen.kernel_kind(problem.pair_count, problem.name)
    Capability.RESIDUAL.require(type(kernel_kind) in residual_kinds_of_tables(tables), problem.name)
    return cpu.residuals(tables, kernel_kind, first, second)


def match(
    source: ArrayLike,
    target: ArrayLike,
    problem: Problem,
    *,
    noise: ArrayLike | Literal["auto"] = 1.0,
    normals: ArrayLike | None = None,
    view_angle: ArrayLike | None = None,
    detection_rate: float | None = None,
    resolution: float | None = None,
    min_probability: float | None = None,
    candidates: ArrayLike | None = None,
    bodies: ArrayLike | None = None,
    motions: int | Literal["auto"] = 1,
    prior: Prior | Mapping[Label, Prior] | None = None,
    source_noise: ArrayLike | None = None,
    seed: int = 0,
    max_seconds: float | None = None,
    progress: Progress | None = None,
    sampler: SamplerName | Sampler | None = None,
    samples: int | None = None,
    residual: str | Residual | None = None,
    rho: float | None = None,
    solver: str | Solver | None = None,
    preset: Literal["paper"] | None = None,
    backend: selection.Name = "auto",
    scheduler: str | None = None,
    max_hyperedges: int = 5_000_000,
    max_evaluations: int | None = None,
) -> Match:
    """Match two point sets by geometry alone.

    Parameters
    ----------
    source : (n, 3) or (n, 2) array
        Points in space in any frame and unit, or pixels of the first image.
    target : (n', 2) array
        Pixels (x right, y down), in any order, including clutter. For a `rootmatch.Rig`, ``(pixels, index)``,
        rows of x, y and the index of the camera, or a list of arrays (m, 2), one for each camera: those are numbered as
        after ``np.concatenate``. For `rootmatch.Bearings`, unit rays (n', 3); for two point sets, points (n', 2) or
        (n', 3).
    problem : Problem
        `P3P`, `UP2P`, `ThreePlusOne`, or another one.
    noise : float, (n',) array, pair or "auto"
        Standard deviation of a coordinate: in pixels in an image, in the unit of the points for two point sets. One
        number for all points, or one for each target point. Where both sets are noisy, as with two images or two point
        sets (`ThreePlusOne`, `PlanarMotion`, `Similarity`, `Rigid`), one number holds for both, n' numbers are those of
        the target with their root mean square for the source, and a pair ``(source, target)`` gives each, as a number
        or one for each point: ``(0.0, 0.3)`` for an exact plan. For `Similarity` and `Rigid`, each may also be a σ for
        each axis, (m, k) for m points, or covariances (m, k, k); the search then gates with the mean over the axes, and
        matches are weighed and poses fitted with all of it. For P3P and UP2P, also with rigs, it may be the covariance
        of each detection, (n', 2, 2) in px², as of blobs that motion blurs along a direction; searches gate with the
        mean over the axes, the model of the image has all of it. For a rig, a list may have one of these for each
        camera. ``"auto"`` estimates it from the match, in a few rounds; with ``source_noise``, it estimates that of the
        detections alone. The noise of a target must not be zero.
    normals : (n, 3) array, optional
        Outward normals of the source points: a point is visible only from its front. A row of zeros is an unknown
        normal.
    view_angle : float or (n,) array, optional
        Angle from its normal up to which a point is visible, in radians, in (0, π]; by default π/2, less likely beyond
        π/3. The edge is soft: visibility fades within a few degrees on either side, is half at the angle itself, and is
        nil from a cosine of 0.15 beyond it (9° at an angle of 70°). Needs normals.
    detection_rate : float, optional
        Probability that a visible point is detected: each point that a pose predicts and that is not detected counts
        against the pose. Estimated by default.
    resolution : float, optional
        Distance in pixels below which the detector merges two points of a body into one detection, at their mean.
        `Match.assignment` then names the most certain of these points, and the others count as hidden. By default every
        point has its own detection. For P3P and UP2P with cameras that have pixels, also in rigs.
    min_probability : float, optional
        Posterior probability from which a match is trusted: its pose, and those of its matches that remain when
        doubtful ones are left out. By default 0.95. Below 0.999, as the model itself may be wrong.
    candidates : (n, n') array, optional
        Booleans: the possible correspondences. Numbers: weights, such as likelihood ratios of a measurement, which
        count as evidence; only their ratios within a row matter. 0 excludes a correspondence.
    bodies : (n,) array of whole numbers or strings, optional
        The rigid body that each source point belongs to: bodies move independently, hyper-edges stay within a body, and
        no detection is used twice. `Match.bodies` has the match of each body; the whole is as trustworthy as the least
        trusted one.
    motions : int or "auto"
        Number of rigid motions to find.
    prior : Pose, PosePrior or dict, optional
        A predicted pose with its covariance, ``Pose(R, t, covariance)``: it narrows the candidates and enters the fit
        as a Gaussian, so three visible points are enough. If it settles the match, no search is needed. Otherwise a
        full search runs without it, and `Match.prior_holds` says whether the prediction was right. Partial knowledge, a
        rotation, a position or a vertical, is a `rootmatch.PosePrior`: it narrows the search and enters the fit. For
        P3P, also with rigs, UP2P, and Rigid and Similarity, whose pose is that of the motion; for Similarity, a
        covariance (7, 7) covers the scale as well and (6, 6) leaves it open; in a plane these are (4, 4) and (3, 3).
        With ``bodies``, a dict from labels to either.
    source_noise : float, (n,), (n, 3) or (n, 3, 3) array, optional
        Standard deviation of a coordinate of the source points, in their unit: one number for all, one for each point,
        or one for each axis of each point; or the covariance of each point. Exact by default. For P3P and UP2P, also
        with rigs; where both sets are noisy anyway, it replaces the first of the pair that ``noise`` may be.
    seed : int
        Random seed; the same seed gives the same match.
    max_seconds : float, optional
        Time limit: when it is reached, the best match so far is returned, with its own status and with
        `Match.stopped_early` set. It holds to within a tenth plus 5 ms once everything is compiled. What is found in
        time depends on the machine.
    progress : callable, optional
        Called with (done, total) between blocks.
    sampler : {"auto", "exhaustive", "random", "guided"} or Sampler
        Which hyper-edges are evaluated: all, random ones, or those that a guided search finds. You can also pass a
        sampler: `rootmatch.Guided` with its options, `rootmatch.samplers.completion.Completion`, or one of your own,
        which takes a `rootmatch.samplers.base.SamplingTask`. ``"auto"`` is ``"guided"`` for two images, two point sets
        and `UP2PF`. For P3P and UP2P it is so above a hundred thousand hyper-edges, and up to two million all of them
        are evaluated afterwards if the match is not trusted. With several motions it is ``"guided"`` above 200 million
        or, if the problem supports it, completes minimal sets to find all hyper-edges that agree.
    samples : int, optional
        Number of random hyper-edges, 100,000 by default. It selects the random sampler, and is refused with any other.
    residual : str or Residual
        How badly the correspondences of a hyper-edge agree: ``"joint"``, the default, and ``"normalised"`` are in units
        of the noise; ``"qr"``, ``"qr-both"`` and ``"svd"`` are those of the paper, whose matches no pose judges.
        See `rootmatch.Residual`.
    rho : float, optional
        Spread ρ of the affinity, in units of the residual r: a weight is exp(−r² / 2ρ²) in units of the noise, where ρ
        is 1 by default, and exp(−r / ρ) for the paper's, where it is `Problem.paper_rho`, or
        `Problem.paper_rho_of_exact_data` where σ is at most 0.01.
    solver : str or Solver
        From the tensor to an assignment: ``"ascent"`` by default, others are in `rootmatch.solvers.SOLVERS`. It decides
        with the residuals of the paper, for problems without poses and with several motions. Otherwise poses decide:
        its assignment is a proposal among those of the hyper-edges, and an `InputWarning` says so.
    preset : "paper", optional
        The published method: random hyper-edges, ∣R₂ₙ,₂ₙ∣ of one pair, a ρ for each problem, power iteration with ℓ¹
        rows. A point stays unmatched only if no hyper-edge supports any of its targets. Other arguments override parts
        of it: ``solver="power-l1-balanced"`` is better if n = n'. The default is all hyper-edges, the joint residual
        and the multi-start ascent.
    backend : {"auto", "cpu", "cuda", "cuda-float32"}
        Where hyper-edges are evaluated and the tensor is contracted: on the CPU, or on an NVIDIA GPU through numba-cuda
        (the extra ``gpu``). ``"auto"`` is the GPU if there is one and at least 200 million hyper-edges are evaluated. A
        guided search runs on the CPU; with ``"cuda"`` it is used only above 10⁹ hyper-edges. ``"cuda-float32"``
        evaluates all hyper-edges in single precision and those that pass again in double: for ``"joint"`` and
        ``"normalised"`` of P3P and up2p, where ``"auto"`` uses it on GPUs that are slow in double.
    scheduler : str, optional
        Address of a Dask scheduler (the extra ``cluster``), ``tcp://host:port``. Its workers, which need this version
        of the package, evaluate the hyper-edges, all of them or random ones. The tensor is bit-identical.
    max_hyperedges : int
        Maximum number of hyper-edges kept, the strongest ones; 24 bytes each at order 4.
    max_evaluations : int, optional
        Maximum number of hyper-edges that an exhaustive search may evaluate; by default 4e9 on the CPU, 1e11 on a GPU.

    Returns
    -------
    Match

    Raises
    ------
    InputError
        If the input cannot be used or is larger than the limits; the text says what to do. This includes a target with
        fewer points than a hyper-edge has, 4 for `P3P` (with ``prior``, one without any); `Matcher` and `Tracker`
        return an untrusted match instead.
    """
    started = time.perf_counter()
    options = MatchOptions.among(locals())
    task = MatchingTask.of(
        problem,
        source,
        target,
        noise=noise,
        normals=normals,
        view_angle=view_angle,
        candidates=candidates,
        bodies=bodies,
        prior=prior,
        source_noise=source_noise,
        options=options,
        deadline=Deadline(max_seconds, started=started),
    )
    found = explain(task)
    return report(found, seconds=time.perf_counter() - started, stopped_early=task.deadline.stopped_early)
