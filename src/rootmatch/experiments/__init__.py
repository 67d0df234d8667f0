"""The paper's experiments: what is run, where its results are kept, and what they say."""
