"""Poses at which the projected points of a body are as dense as the detections, where minimal sets are too vague."""
