"""Congruence and similarity: point sets of one space that a rigid motion, or a scaled one, takes to each other."""

from rootmatch.problems.similarity.problem import Rigid as Rigid
from rootmatch.problems.similarity.problem import Similarity as Similarity
