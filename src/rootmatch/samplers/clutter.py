"""How dense clutter is taken to be where detections are predicted."""

CROWDING = 1.5
"""How much denser clutter is taken to be than detections are on average.

Detections crowd about what is visible, and predictions fall there too: chance meets one more often than their mean
density says. A round factor on the safe side; a predicted point that meets a detection is worth the less for it.
"""
