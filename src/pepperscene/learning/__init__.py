"""Training networks on labelled images, and evaluating them (extra `learn`)."""
