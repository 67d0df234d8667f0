"""Cameras: from pixels to bearings and back, with their noise."""
