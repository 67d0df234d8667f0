"""Upright pose with unknown focal length: points in space and their image, the vertical known, the zoom not."""

from rootmatch.problems.up2pf.problem import UP2PF as UP2PF
