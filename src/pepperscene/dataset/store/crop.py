"""The cultivars of a data set and the names of their crops."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final

from pepperscene.dataset.store.recorded_values import recorded_values
from pepperscene.errors import InputError
from pepperscene.shipped import is_file, shipped_folder

_SHIPPED_NAME: Final = re.compile(r"[A-Za-z0-9_-]+")
_COMMON_NAMES: Final = {"Capsicum annuum": "sweet pepper"}
_FRUIT_NAMES: Final = {
    "Capsicum annuum": "pepper",
    "Cucumis sativus": "cucumber",
    "Solanum lycopersicum": "tomato",
    "Solanum melongena": "eggplant",
}
"""Names of the class `pepper`, fruit, by species; all species of the shipped cultivars."""


def cultivar_names(info: Mapping[str, Any]) -> tuple[str, ...]:
    """The names of a data set's cultivars: one, unless the recipe varies it.

    Args:
        info: the content of `dataset.json`, of valid types.
    """
    return tuple(dict.fromkeys(map(str, recorded_values(info, "cultivar"))))


def crop_name(info: Mapping[str, Any]) -> str:
    """The crops of a data set, joined by "and": the common name "sweet pepper", or the species of another.

    `dataset.json` has only the name of a cultivar. The species of a cultivar that is not shipped is unknown;
    its own name is used instead.

    Args:
        info: the content of `dataset.json`, of valid types.
    """
    return " and ".join(dict.fromkeys(map(_crop_of_cultivar, cultivar_names(info))))


def fruit_name(info: Mapping[str, Any]) -> str:
    """The name of the fruit of a data set, such as "tomato"; "fruit" of other, unknown or several crops.

    Args:
        info: the content of `dataset.json`, of valid types.
    """
    names = {_FRUIT_NAMES.get(_species(name) or "", "fruit") for name in cultivar_names(info)}
    return names.pop() if len(names) == 1 else "fruit"


def _crop_of_cultivar(name: str) -> str:
    species = _species(name)
    return name if species is None else _COMMON_NAMES.get(species, species)


@lru_cache(maxsize=64)
def _species(name: str) -> str | None:
    """The species of a shipped cultivar; None for others."""
    from pepperscene.cultivar import load_cultivar

    # The data set may be from anyone: a name must not be read as the path of another file.
    if not _SHIPPED_NAME.fullmatch(name) or not is_file(shipped_folder("plants") / f"{name}.toml"):
        return None
    try:
        return load_cultivar(name).species
    except InputError:
        return None
