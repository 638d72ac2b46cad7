"""Evaluation of trained models on labelled images, and predictions for images."""
