"""Round organs along a centreline: stems, stalks, flowers and twine."""
