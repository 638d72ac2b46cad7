"""The names of the environments, known to gymnasium after this module is imported."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from pepperscene.libraries import import_library

ENVIRONMENTS: Final[Mapping[str, str]] = {
    "pepperscene/NextBestView-v0": "pepperscene.environments.next_best_view:NextBestView",
    "pepperscene/Reach-v0": "pepperscene.environments.reach:Reach",
}
"""Module and class of each environment, imported when one is made."""

_gymnasium = import_library("gymnasium", "gym")
for _name, _entry_point in ENVIRONMENTS.items():
    _gymnasium.register(_name, _entry_point)
