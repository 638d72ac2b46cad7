"""Visibility of fruit from many camera poses: sampled surfaces and batched shadow rays."""
