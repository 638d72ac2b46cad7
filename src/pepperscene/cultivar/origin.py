"""Where a number comes from."""

from __future__ import annotations

from typing import Self

from pydantic import model_validator

from pepperscene.document import Document


class Origin(Document):
    """Where a number comes from: a `source`, or `chosen` and why; one of them must be there."""

    source: str = ""
    chosen: str = ""
    as_printed: str = ""
    used: str = ""

    @model_validator(mode="after")
    def _has_origin(self) -> Self:
        if not (self.source.strip() or self.chosen.strip()):
            raise ValueError("needs a source, or chosen and why")
        return self
