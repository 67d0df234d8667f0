"""From what the caller gave to a match: the task, sampling, several motions, assessment."""
