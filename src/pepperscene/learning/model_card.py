"""The model card of a trained network: what it is for, how it was made, and what it was measured on.

Mitchell et al. 2019, "Model cards for model reporting", FAT*.
"""

from __future__ import annotations

from typing import Final

from jinja2 import Environment, PackageLoader, StrictUndefined

from pepperscene.classes import OrganClass
from pepperscene.learning.models.trained_model import TrainedModel
from pepperscene.learning.options import MEASURES
from pepperscene.version import __version__

CARD_FILE: Final = "model_card.md"

_SHOWN_OPTIONS: Final = (
    "model", "steps", "batch", "size", "width", "learning_rate", "schedule", "balance", "lovasz",
    "least_area", "augmentation", "seed", "precision",
)  # fmt: skip


def model_card(model: TrainedModel) -> str:
    """The card in Markdown, of the record of the training."""
    environment = Environment(
        loader=PackageLoader("pepperscene.learning"),
        autoescape=False,  # Markdown; names are in code spans
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    environment.filters["code"] = lambda text: f"`{' '.join(str(text).replace('`', '').split())}`"
    record, organs = model.training, [organ.name.lower() for organ in OrganClass]
    classes = [
        (name, ", ".join(organs[class_id] for class_id in sorted(members)))
        for name, members in zip(model.classes.names, model.classes.members, strict=True)
    ]
    options = record["options"]
    return environment.get_template(CARD_FILE).render(
        model=model,
        record=record,
        classes=classes,
        options={name: options[name] for name in _SHOWN_OPTIONS if name in options},
        quality=record.get(f"validation_{MEASURES[model.task]}"),
        is_rendered=all(item["recipe_sha256"] for item in record["sets"]),
        version=__version__,
    )
