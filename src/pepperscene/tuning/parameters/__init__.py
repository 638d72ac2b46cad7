"""Parameters of a fit: tunable values, their prior distributions, and a recipe's parts at given values."""
