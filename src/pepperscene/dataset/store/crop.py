"""The name of the crop that a data set shows."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

from pepperscene.errors import InputError
from pepperscene.shipped import is_file, shipped_folder

_SHIPPED_NAME: Final = re.compile(r"[A-Za-z0-9_-]+")
_COMMON_NAMES: Final = {"Capsicum annuum": "sweet pepper"}


def crop_name(info: Mapping[str, Any]) -> str:
    """The common name "sweet pepper", or the species of another crop, from a `dataset.json` of valid types.

    A data set holds the name of its cultivar only. One that is not shipped is named itself.
    """
    from pepperscene.cultivar import load_cultivar

    name = str(info["recipe"]["cultivar"])
    # The name of a data set from anywhere must not lead to another file.
    if not _SHIPPED_NAME.fullmatch(name) or not is_file(shipped_folder("plants") / f"{name}.toml"):
        return name
    try:
        species = load_cultivar(name).species
    except InputError:
        return name
    return _COMMON_NAMES.get(species, species)
