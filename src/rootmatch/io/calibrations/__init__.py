"""Cameras from the files of calibration tools, one module per format."""
