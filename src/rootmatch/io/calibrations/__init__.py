"""Cameras from the files of calibration tools, one format a module."""
