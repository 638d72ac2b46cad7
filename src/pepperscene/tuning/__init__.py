"""The tuning room: pigments, light and exposure fitted to measured colour by the renderer's derivatives."""

__all__: list[str] = []
