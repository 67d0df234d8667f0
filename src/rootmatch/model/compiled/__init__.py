"""Compiled parts of the model of an image, each for poses and assignments by the dozen."""
