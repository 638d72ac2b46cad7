"""Parameters of a fit: what can be tuned, its prior distribution, and a recipe's parts at given values."""
