"""Published results on the same protocols, read off figures: about two digits."""

from __future__ import annotations

from rootmatch.research.hypergraph.protocol import DEFORMATION, OUTLIERS

METHODS = {"power-l1": "TM", "rrwhm-published": "RRWHM", "bcagm": "BCAGM"}
"""Solvers here, and the published methods that they correspond to."""

ACCURACY: dict[tuple[str, float], dict[str, float]] = {
    (DEFORMATION, 0.2): {"TM": 0.71, "RRWHM": 0.80, "BCAGM": 0.79},
    (DEFORMATION, 0.3): {"TM": 0.49, "RRWHM": 0.63, "BCAGM": 0.61},
    (DEFORMATION, 0.4): {"TM": 0.34, "RRWHM": 0.45, "BCAGM": 0.41},
    (OUTLIERS, 20): {"TM": 0.85, "RRWHM": 1.0, "BCAGM": 1.0},
    (OUTLIERS, 100): {"TM": 0.73, "RRWHM": 0.87, "BCAGM": 0.91},
    (OUTLIERS, 200): {"TM": 0.35, "RRWHM": 0.57, "BCAGM": 0.64},
}
"""Mean accuracy over 100 trials, by protocol and σ or number of outliers."""

MILLISECONDS = {"TM": 190.0, "RRWHM": 30.0, "BCAGM": 10.0}
"""One thread, n = 20, about 0.8 million symmetric nonzeros; another machine."""
