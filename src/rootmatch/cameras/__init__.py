"""Cameras: from pixels to bearings and back."""
