"""The least-squares fit, its result and diagnostics."""
