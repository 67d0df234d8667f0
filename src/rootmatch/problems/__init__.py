"""The geometric problems, one a file."""
