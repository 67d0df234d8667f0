"""What is known of something that is so or not so, and changes now and then."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np

from rootmatch.arrays import Floats

Chance = TypeVar("Chance", float, Floats)


def later_chance(chance: Chance, usual: float, seconds: float, lasts: float) -> Chance:
    """A probability some seconds later: it goes back to the ``usual`` one, by e within ``lasts`` seconds."""
    return usual + (chance - usual) * math.exp(-seconds / lasts)


def log_chance(chance: Floats) -> Floats:
    """Logarithms of probabilities, finite where these are 0."""
    return np.asarray(np.log(np.maximum(chance, 1e-300)))
