"""Guided search between two views: relative poses from minimal sets, each judged by all points."""
