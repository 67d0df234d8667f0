"""How dense clutter is taken to be where detections are predicted."""

CROWDING = 1.5
"""How much denser clutter is taken to be than detections are on average.

Detections crowd about the visible object, and predictions fall there too: chance hits one more often than the mean
density says. A round factor on the safe side, which lowers the evidence of a hit; not tuned.
"""
