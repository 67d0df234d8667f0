"""The upright two-point problem: points in space and their image in a camera whose vertical is known."""

from rootmatch.problems.up2p.problem import UP2P as UP2P
