"""How probable each detection is as the image of each point, by the pose of the other points, compiled."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.decorators import driver


@driver(nogil=True, error_model="numpy")
def predicted_densities(target, variance, assignment, predicted, jacobian, covariance, seen, inflation, out):  # type: ignore[no-untyped-def]
    """Fill in the logarithms (n, n') of the densities; see `AbsoluteFit.densities`.

    Parameters
    ----------
    target : (n', 2) array
    variance : (n',) array
    assignment : (n,) int64 array
    predicted : (n, 2) array
    jacobian : (n, 2, p) array
    covariance : (p, p) array
    seen : (n,) bool array
    inflation : float
    out : (n, n') array
    """
    size = covariance.shape[0]
    product = np.empty((2, size))
    constant = math.log(2.0 * math.pi * inflation)
    alike = True
    for j in range(target.shape[0]):
        alike = alike and variance[j] == variance[0]
    for i in range(predicted.shape[0]):
        if not seen[i]:
            out[i] = -np.inf
            continue
        for row in range(2):
            for p in range(size):
                value = 0.0
                for q in range(size):
                    value += jacobian[i, row, q] * covariance[q, p]
                product[row, p] = value
        suu, suv, svu, svv = 0.0, 0.0, 0.0, 0.0
        for p in range(size):
            suu += product[0, p] * jacobian[i, 0, p]
            suv += product[0, p] * jacobian[i, 1, p]
            svu += product[1, p] * jacobian[i, 0, p]
            svv += product[1, p] * jacobian[i, 1, p]
        u, v = predicted[i, 0], predicted[i, 1]
        k = assignment[i]
        if k >= 0:
            # without its own match a prediction moves away from it and is less certain, by the hat matrix
            scale = 1.0 / variance[k]
            a, b = 1.0 + 1e-9 - suu * scale, -suv * scale
            c, d = -svu * scale, 1.0 + 1e-9 - svv * scale
            inverse = 1.0 / (a * d - b * c)
            ru, rv = target[k, 0] - u, target[k, 1] - v
            u = target[k, 0] - (d * ru - b * rv) * inverse
            v = target[k, 1] - (a * rv - c * ru) * inverse
            suu, suv, svu, svv = (
                (d * suu - b * svu) * inverse, (d * suv - b * svv) * inverse,
                (a * svu - c * suu) * inverse, (a * svv - c * suv) * inverse,
            )  # fmt: skip
        across = 0.5 * (suv + svu)
        if alike:
            # detections that are all equally noisy share all but the distance, in a loop that vectorises
            a, c = suu + variance[0], svv + variance[0]
            determinant = max(a * c - across * across, 1e-300)
            logarithm, inverse = 0.5 * math.log(determinant) + constant, -0.5 / (determinant * inflation)
            a, b, c = a * inverse, -2.0 * across * inverse, c * inverse
            for j in range(target.shape[0]):
                x, y = target[j, 0] - u, target[j, 1] - v
                value = c * x * x + b * x * y + a * y * y - logarithm
                out[i, j] = value if abs(value) < np.inf else -np.inf
            continue
        for j in range(target.shape[0]):
            a, c = suu + variance[j], svv + variance[j]
            determinant = max(a * c - across * across, 1e-300)
            x, y = target[j, 0] - u, target[j, 1] - v
            chi2 = (c * x * x - 2.0 * across * x * y + a * y * y) / (determinant * inflation)
            value = -0.5 * chi2 - 0.5 * math.log(determinant) - constant
            out[i, j] = value if math.isfinite(value) else -np.inf
