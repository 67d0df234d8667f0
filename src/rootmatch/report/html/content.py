"""Content of a report: plain numbers and strings about a match, which the page's script draws."""

from __future__ import annotations

import base64
import math
import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.errors import InputError
from rootmatch.io.pose_files import finite_or_none
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.report.drawn_poses import round_factor
from rootmatch.report.html.camera_view import camera_view
from rootmatch.report.text import describe_weight, join_names, match_weights, point_names, summarise_match

if TYPE_CHECKING:
    from rootmatch.result import Match


ALTERNATIVES = 8
"""Alternatives shown, the most probable ones. Not tuned: what fits a row of tabs."""
DRAWN = 0.05
"""Share of the image's width that the longest residual is drawn with."""
MARGIN = 0.06
PICTURES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}


def report_content(
    match: Match,
    *,
    source_names: Sequence[str] | None = None,
    target_names: Sequence[str] | None = None,
    truth: Integers | None = None,
    photo: Path | None = None,
) -> dict[str, Any]:
    """All that the page shows, as JSON can hold it; arguments as of `rootmatch.report.html.write_report`."""
    target_title = "Image" if _is_projection(match) else "Second image" if _is_two_images(match) else "Target"
    target_side = _side_record(match.target, target_title, target_title != "Target")
    if photo is not None:
        target_side["photo"], (width, height) = _embed_photo(photo)
        target_side["photoSize"] = width, height
        left, top, right, bottom = target_side["extent"]
        target_side["extent"] = [min(left, -0.5), min(top, -0.5), max(right, width - 0.5), max(bottom, height - 0.5)]
    source_title = "Model" if _is_projection(match) else "First image" if _is_two_images(match) else "Source"
    names = point_names(source_names, len(match.source)), point_names(target_names, len(match.target))
    views = _list_views(match, *names)
    if truth is not None:
        for view in views:
            found = np.array(view["assignment"])
            view["wrong"] = ((found >= 0) & (found != truth)).tolist()
    return {
        "source": match.source.tolist(),
        "sourceNames": names[0],
        "sourceSide": _side_record(match.source, source_title, _is_two_images(match)),
        "target": match.target.tolist(),
        "targetNames": names[1],
        "targetSide": target_side,
        "status": match.status.name.lower(),
        "summary": f"{match.status.name.lower()}: {summarise_match(match)}",
        "advice": match.advice.partition(": ")[2] or match.advice,
        "views": views,
        "truth": None if truth is None else truth.tolist(),
        "scale": _residual_scale(views[0], match.target),
    }


def list_facts(match: Match) -> list[tuple[str, str]]:
    """Settings, effort and versions, one per line."""
    options = match.task.options
    noise = match.noise
    used = {
        "Problem": repr(match.problem),
        "Points": f"{len(match.source)} source, {len(match.target)} target",
        "Noise": f"{noise:.4g}" if isinstance(noise, int | float) else "differs by point",
        **({"Points off by": f"{match.point_error:.2g} on each axis"} if match.point_error else {}),
        "Hyper-edges evaluated": f"{match.evaluated:,}",
        "Hyper-edges kept": f"{len(match.tensor.weights):,}",
        "Solver": "stopped by its own criterion" if match.converged else "stopped at a limit",
        "Evidence and margin": f"{describe_weight(match)}, {match.margin:.3f}",
        "Seconds": f"{match.seconds:.3g}",
        "Seed": str(options.seed),
        "Options": ", ".join(f"{name}={value!r}" for name, value in _changed_options(options).items()) or "defaults",
        "Versions": ", ".join(
            [
                *(f"{name} {version(name)}" for name in ("rootmatch", "numpy", "numba")),
                f"Python {platform.python_version()}",
            ]
        ),
    }
    return list(used.items())


def _changed_options(options: Any) -> dict[str, Any]:
    """Options of a match that are not the defaults."""
    default = type(options)()
    return {
        name: value
        for name, value in vars(options).items()
        if name not in ("seed", "progress") and not name.startswith("_") and value is not getattr(default, name, None)
        and value != getattr(default, name, None)
    }  # fmt: skip


def _list_views(match: Match, source_names: Sequence[str], target_names: Sequence[str]) -> list[dict[str, Any]]:
    """The best assignment, its other poses, and the most probable alternatives."""
    fits = match.problem.min_for_pose > 0
    views = [_view_record(match, match.assignment, match.poses if fits else [], "best", probability=match.probability)]
    for rank, (pose, likely) in enumerate(match.other_poses, start=1):
        shown, title = "Differs only in its pose", f"other pose {rank}"
        views.append(_view_record(match, match.assignment, [pose], title, probability=likely, differs=shown))
    poses = match.alternative_poses if fits else [[]] * len(match.alternatives)
    chances = None if match.bodies else match.finding.alternative_probabilities
    unknown = [None] * len(poses)
    alternatives = list(zip(match.alternatives, poses, unknown if chances is None else chances, strict=True))
    for rank, ((other, score), fitted, chance) in enumerate(alternatives[:ALTERNATIVES], start=1):
        differs = _describe_difference(other, match.assignment, source_names, target_names)
        known = "" if score is None or match.score is None else f"Score {score:.4g} instead of {match.score:.4g}. "
        shown, title = f"{known}Differs in: {differs}", f"alternative {rank}"
        views.append(_view_record(match, other, fitted, title, probability=chance, differs=shown))
    return views


def _view_record(
    match: Match,
    assignment: Integers,
    poses: Sequence[Pose | None],
    title: str,
    *,
    probability: float | None = None,
    differs: str = "",
) -> dict[str, Any]:
    """One assignment with its poses: what they predict, and how far the detections are from it."""
    n = len(assignment)
    labels = match.motion_labels if title == "best" else np.maximum(match.motion_labels, 0)
    motions = np.where(assignment >= 0, labels, -1)
    residuals: list[float | None] = [None] * n
    predicted: list[list[float] | None] = [None] * n
    sigma = np.broadcast_to(np.asarray(match.task.points.target_noise, dtype=float), (len(match.target),))
    for label, pose in enumerate(poses):
        if pose is None or pose.points is None or pose.predicted is None or pose.residuals is None:
            continue
        for point, where, distance in zip(
            pose.points.tolist(), pose.predicted.tolist(), pose.residuals.tolist(), strict=True
        ):
            predicted[point] = where
            residuals[point] = float(distance / sigma[assignment[point]])
        if label == 0 and _is_projection(match):
            _predict_unmatched(match, pose, assignment, predicted)
    weights = match_weights(match)
    return {
        "title": title,
        "probability": finite_or_none(probability),
        "differs": differs,
        "assignment": assignment.tolist(),
        "motions": motions.tolist(),
        "weights": np.nan_to_num(weights / max(float(weights.max(initial=0.0)), 1e-300)).tolist(),
        "confidence": [finite_or_none(value) for value in match.confidence.tolist()] if title == "best" else None,
        "residuals": residuals,
        "predicted": predicted,
        "dimensions": 1 if _is_two_images(match) else match.target.shape[1],
        "fit": _fit_summary(poses),
        "poses": [None if pose is None else _html_pose_record(match, pose, label) for label, pose in enumerate(poses)],
    }


def _predict_unmatched(match: Match, pose: Pose, assignment: Integers, predicted: list[list[float] | None]) -> None:
    """Predicted positions of the unmatched points that are in front of the camera and face it."""
    camera = getattr(match.problem, "camera", None)
    unmatched = np.flatnonzero(assignment < 0)
    if camera is None or not len(unmatched) or len({int(m) for m in match.motion_labels if m >= 0}) > 1:
        return
    moved = pose.transform(match.source[unmatched])
    shown = moved[:, 2] > 0.0
    normals = match.task.points.normals
    if normals is not None:
        facing = ((normals[unmatched] @ pose.R.T) * -moved).sum(axis=1)
        shown &= (facing > 0.0) | ~normals[unmatched].any(axis=1)
    low, high = match.target.min(axis=0), match.target.max(axis=0)
    try:
        pixels = camera.project(moved[shown])
    except InputError:
        return  # beyond what the lens can show
    near = ((pixels > low - (high - low)) & (pixels < high + (high - low))).all(axis=1)
    for point, pixel in zip(unmatched[shown][near].tolist(), pixels[near].tolist(), strict=True):
        predicted[point] = pixel


def _fit_summary(poses: Sequence[Pose | None]) -> str:
    """χ² of the fits and how often chance alone exceeds it."""
    from scipy.stats import chi2 as distribution  # slow to import

    parts = []
    for label, pose in enumerate(poses):
        if pose is None or pose.chi2 is None or not pose.dof:
            continue
        tail = float(distribution.sf(pose.chi2, pose.dof))
        which = f"Motion {label}: " if len(poses) > 1 else ""
        parts.append(
            f"{which}χ² {pose.chi2:.3g} with {pose.dof} degrees of freedom; noise alone exceeds it in {tail:.1%} of "
            "cases."
        )
    return " ".join([*parts, "Dashed: what the stated noise would give."])


def _html_pose_record(match: Match, pose: Pose, label: int) -> dict[str, Any]:
    """A pose as text, and its camera in the frame of the points."""
    lines = [f"motion {label}" if match.motion_labels.max(initial=0) > 0 else "pose"]
    lines = lines if match.bodies is None else [f"body {list(match.bodies)[label]}"]
    for row, value in zip(pose.R.tolist(), pose.t.tolist(), strict=True):
        lines.append(f"  R {' '.join(f'{one: .6f}' for one in row)}  t {value: .6g}")
    if pose.scale != 1.0:
        lines.append(f"  scale {pose.scale:.6g}")
    if pose.focal is not None:
        lines.append(f"  focal length {pose.focal:.6g} px")
    if pose.rms is not None:
        lines.append(f"  RMS {pose.rms:.3g}" + ("" if pose.rms_sigma is None else f", {pose.rms_sigma:.3g} σ"))
    if pose.covariance is not None:
        spread = np.sqrt(np.maximum(np.diag(pose.covariance), 0.0))
        angles = 3 if len(pose.R) == 3 else 1
        rotation = ", ".join(f"{value:.2g}" for value in np.rad2deg(spread[:angles]).tolist())
        translation = ", ".join(f"{value:.2g}" for value in spread[angles : angles + len(pose.t)].tolist())
        lines += ["  standard deviations", f"    rotation {rotation}°", f"    translation {translation}"]
    shown = camera_view(match, pose) if _is_projection(match) else {"frustum": None}
    return {"motion": label, "text": "\n".join(lines), **shown}


def _is_projection(match: Match) -> bool:
    """Whether points in space are seen by a camera."""
    return bool(match.source.shape[1] == 3 and match.target.shape[1] == 2)


def _is_two_images(match: Match) -> bool:
    """Whether both sets are pixels, which bind one another to a line only."""
    return bool(match.source.shape[1] == 2 and match.problem.name not in ("similarity", "rigid"))


def _side_record(points: Floats, title: str, image: bool) -> dict[str, Any]:
    """How a point set is drawn."""
    side: dict[str, Any] = {"title": title, "dimension": points.shape[1], "image": image, "note": ""}
    if points.shape[1] == 3:
        side["note"] = "Drag to turn, scroll to zoom."
        return side
    low, high = points.min(axis=0), points.max(axis=0)
    margin = MARGIN * max(float((high - low).max()), 1e-12)
    side["extent"] = [*(low - margin).tolist(), *(high + margin).tolist()]
    return side


def _embed_photo(photo: Path) -> tuple[str, tuple[int, int]]:
    """A photograph as a data address, and its width and height in pixels."""
    from PIL import Image, UnidentifiedImageError

    kind = PICTURES.get(photo.suffix.lower())
    if kind is None:
        raise InputError(f"photo {photo}: give a {', '.join(PICTURES)} file")
    try:
        with Image.open(photo) as picture:
            size = picture.size
        content = photo.read_bytes()
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise InputError(f"photo {photo}: cannot be read as a picture ({error})") from None
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}", size


def _residual_scale(view: dict[str, Any], target: Floats) -> int:
    """Factor by which residuals are drawn longer than they are: 1, 2, 5, 10 and so on."""
    lengths = [
        math.dist(where, target[j])
        for where, j in zip(view["predicted"], view["assignment"], strict=True)
        if where is not None and j >= 0
    ]
    longest = max(lengths, default=0.0)
    ratio = DRAWN * float(np.ptp(target, axis=0).max()) / longest if longest > 0.0 else 1.0
    return int(round_factor(min(ratio, 1e6)))


def _describe_difference(other: Integers, best: Integers, source: Sequence[str], target: Sequence[str]) -> str:
    changed = np.flatnonzero(other != best).tolist()
    return join_names([f"{source[i]} → {target[other[i]] if other[i] >= 0 else 'unmatched'}" for i in changed]) + "."
