"""Several motions: groups of points grown one by one, and the most valuable disjoint ones chosen."""
