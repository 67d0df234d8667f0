"""The paper's experiments: its settings and methods, what is run of them, the figures, and which claims hold."""
