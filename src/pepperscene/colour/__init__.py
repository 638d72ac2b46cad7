"""The colour room: patches of measured colour, what they have in common, and how alike two sets are."""

__all__: list[str] = []
