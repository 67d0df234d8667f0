"""Detections that poses of minimal sets predict in one image or in those of all cameras of a rig, compiled."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.compiled.evidence import LOG_2PI, invert_scaled
from rootmatch.model.compiled.gating import project_pose_covariance, squared_mahalanobis
from rootmatch.model.compiled.projection import linearise_one
from rootmatch.model.compiled.visibility import fill_visibility_of_pose


@part
def gathering_scratch(n_target):  # type: ignore[no-untyped-def]
    """What `gather_one` writes into, for so many detections."""
    return (np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))), np.empty(6), np.zeros(n_target, np.bool_)


@part
def gather_one(k, row, points, sources, image, limits, scratch, out):  # type: ignore[no-untyped-def]
    """What the k-th pose predicts, whose points are a row of ``points``; otherwise as `gather`."""
    pixels, jacobian, visible = points
    target, sigma, log_clutter, log_weights, camera_of = image
    cameras, squared_gate, rate, hidden = limits
    (normal, covariance, factor), scale, used = scratch
    assignments, gains = out
    n = sources.shape[1] // cameras
    normal[:] = 0.0
    used[:] = False
    seen = True
    for i in range(sources.shape[1]):
        j = sources[k, i]
        assignments[k, i] = j
        if j < 0:
            continue
        used[j] = True
        seen = seen and visible[row, i] > hidden
        weight = 1.0 / (sigma[j] * sigma[j])
        for p in range(6):
            for q in range(6):
                first = jacobian[row, i, 0, p] * jacobian[row, i, 0, q]
                normal[p, q] += weight * (first + jacobian[row, i, 1, p] * jacobian[row, i, 1, q])
    gains[k] = -math.inf
    if not seen or not abs(invert_scaled(normal, factor, scale, covariance)) < math.inf:
        return
    total = 0.0
    for camera in range(cameras):
        hits, gain, missed = 0, 0.0, 0.0
        for i in range(camera * n, (camera + 1) * n):
            if not visible[row, i] > hidden:
                continue
            chance = min(rate * visible[row, i], 0.999)
            missed += math.log1p(-chance)
            shown = math.log(chance) - math.log1p(-chance)
            if sources[k, i] >= 0:
                hits += 1
                gain += shown
                continue
            a, b, c = project_pose_covariance(jacobian[row], covariance, i)
            a, c = max(a, 0.0), max(c, 0.0)
            best, found = 0.0, -1
            for j in range(target.shape[0]):
                if used[j] or camera_of[j] != camera:
                    continue
                x, y = target[j, 0] - pixels[row, i, 0], target[j, 1] - pixels[row, i, 1]
                squared, determinant = squared_mahalanobis(a, b, c, sigma[j] * sigma[j], x, y)
                if squared > squared_gate:
                    continue
                value = shown - 0.5 * (squared + math.log(determinant)) - LOG_2PI - log_clutter[j]
                if log_weights.shape[0] > 0:
                    value += log_weights[i, j]
                if value > best:
                    best, found = value, j
            if found >= 0:
                assignments[k, i], used[found] = found, True
                gain += best
                hits += 1
        if hits > 0:  # what a camera shows nothing of may be beyond its image
            total += gain + missed
    gains[k] = total


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def gather(points, sources, image, limits, out):  # type: ignore[no-untyped-def]
    """What each of K poses predicts, the sightings that gain most first come first served.

    Parameters
    ----------
    points : tuple
        Pixels (K, C n, 2), jacobian (K, C n, 2, 6), and visibility (K, C n).
    sources : (K, C n) int64 array
        Detection of each of the three points that a pose is of, −1 elsewhere.
    image : tuple
        Detections (n', 2), their σ (n',), log-density (n',) of clutter, logarithms of the weights of matches (C n, n'),
        −∞ where one is not allowed, no rows if not given, and the number (n',) of the camera of each.
    limits : tuple
        Number of cameras, squared gate, detection rate, and the least visibility of a point with candidates.
    out : tuple
        Assignments (K, C n) and log-odds (K,) against clutter; filled. −∞ for a pose that its three do not determine.
    """
    points, sources, image, out = borrow((points, sources, image, out))
    scratch = gathering_scratch(image[0].shape[0])
    for k in range(sources.shape[0]):
        gather_one(k, k, points, sources, image, limits, scratch, out)


@part
def image_buffers(n, with_normals):  # type: ignore[no-untyped-def]
    """What `linearise_one` writes into, for n points in one pose."""
    cosine = np.empty((1 if with_normals else 0, n))
    pixels, jacobian, by_position = np.empty((1, n, 2)), np.empty((1, n, 2, 6)), np.empty((1, n, 2, 3))
    return pixels, jacobian, by_position, np.empty((1, n), np.bool_), cosine, np.empty((1, n))


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def gather_about(poses, sources, scene, limits, out):  # type: ignore[no-untyped-def]
    """As `gather`, from the poses: where the three points of one are turned away, as in most, no other has an image.

    ``poses``: rotations (K, 3, 3) and positions (K, 3); ``scene``: of `DetectionModel.scene_for_kernels`.
    """
    poses, sources, scene, out = borrow((poses, sources, scene, out))
    body, views, (target, sigma, log_weights, view_cosine, _, image_of), clutter, _ = scene
    points, normals = body
    kinds, numbers, turns, shifts, offsets, sizes, rims = views
    hidden, n = limits[3], sources.shape[1]
    image = target, sigma, clutter[0], log_weights, image_of
    scratch, images = gathering_scratch(target.shape[0]), image_buffers(n, normals.shape[0] > 0)
    visible, pose = np.empty((1, n)), (np.empty((1, 3, 3)), np.empty((1, 3)))
    own_images, own_visible = image_buffers(3, normals.shape[0] > 0), np.empty((1, 3))
    own = np.empty((3, 3)), np.empty((3 if normals.shape[0] > 0 else 0, 3))
    own_cosine = np.empty(3 if view_cosine.shape[0] > 0 else 0)
    for k in range(sources.shape[0]):
        found, camera = 0, 0
        for i in range(n):
            out[0][k, i] = sources[k, i]
            if sources[k, i] >= 0 and found < 3:
                for a in range(3):
                    own[0][found, a] = points[i, a]
                    if normals.shape[0] > 0:
                        own[1][found, a] = normals[i, a]
                if view_cosine.shape[0] > 0:
                    own_cosine[found] = view_cosine[i]
                camera = i // (n // kinds.shape[0])
                found += 1
        for a in range(3):
            pose[1][0, a] = poses[1][k, a]
            for b in range(3):
                pose[0][0, a, b] = poses[0][k, a, b]
        view = (
            kinds[camera : camera + 1], numbers[camera : camera + 1], turns[camera : camera + 1],
            shifts[camera : camera + 1], offsets[camera : camera + 1], sizes[camera : camera + 1],
            rims[camera : camera + 1],
        )  # fmt: skip
        linearise_one(0, own, pose, view, own_images)
        fill_visibility_of_pose(0, own_images[5][0], own_images[4], own_cosine, 0.0, own_visible[0])
        out[1][k] = -math.inf
        if own_visible[0, 0] > hidden and own_visible[0, 1] > hidden and own_visible[0, 2] > hidden:
            linearise_one(0, body, pose, views, images)
            fill_visibility_of_pose(0, images[5][0], images[4], view_cosine, 0.0, visible[0])
            gather_one(k, 0, (images[0], images[1], visible), sources, image, limits, scratch, out)
