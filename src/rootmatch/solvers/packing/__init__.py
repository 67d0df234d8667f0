"""Several motions: groups of correspondences, and the disjoint ones of the highest total evidence."""
