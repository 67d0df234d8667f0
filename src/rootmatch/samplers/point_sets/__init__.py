"""The guided search between two point sets of one space: motions from triples of points, judged by all of them."""
