"""Whole assignments fitted by one pose each: the evidence behind probabilities."""
