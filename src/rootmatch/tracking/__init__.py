"""Tracking of bodies from frame to frame: a motion filter, and several poses while frames do not tell them apart."""
