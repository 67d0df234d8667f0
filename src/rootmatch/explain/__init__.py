"""The stages between the arguments and the match: task, sampling, multi-motion, assessment."""
