"""Zoom: point sets of a plane that a scale and a translation take to each other."""

from .problem import Zoom as Zoom
