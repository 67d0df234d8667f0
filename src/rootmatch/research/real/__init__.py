"""Matching on measured targets with ground truth, for this library and any other: ``rootmatch benchmark real``."""
