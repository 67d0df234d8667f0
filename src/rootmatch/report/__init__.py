"""Results as text and as pictures."""
