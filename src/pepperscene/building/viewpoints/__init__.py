"""What cameras see of a recipe's fruit, and the table of it."""
