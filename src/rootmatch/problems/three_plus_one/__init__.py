"""The three-plus-one problem: two calibrated images that share one known direction."""

from rootmatch.problems.three_plus_one.problem import ThreePlusOne as ThreePlusOne
