"""The geometric problems, a folder each."""
