"""Densities of detections among themselves, against NumPy that shares no code with them."""

from __future__ import annotations

import numpy as np
import pytest

from rootmatch.samplers.guided import detection_grid
from rootmatch.samplers.guided.detection_grid import local_density


def test_local_density_of_neighbours(monkeypatch: pytest.MonkeyPatch) -> None:
    positions = np.random.default_rng(0).uniform(size=(2, 40))
    apart = ((positions[:, :, None] - positions[:, None]) ** 2).sum(axis=0)
    monkeypatch.setattr(detection_grid, "NEIGHBOURS", 9)
    found = local_density(positions, 0.01)
    suu, suv, svv = np.cov(positions, bias=True)[[0, 0, 1], [0, 1, 1]]
    overall = 40 / (4.0 * np.pi * np.sqrt((suu + 1e-4) * (svv + 1e-4) - suv**2))
    expected = np.maximum(overall, 9 / (np.pi * (np.sort(apart, axis=1)[:, 9] + 1e-4)))
    np.testing.assert_allclose(found, expected)
    assert (found > overall).any()
