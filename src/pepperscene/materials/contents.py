"""What the tissue of a surface holds at each of its pigment states, per area, as PROSPECT takes it."""

from __future__ import annotations

from pepperscene.cultivar import PigmentPath
from pepperscene.spectra.spectrum import FloatArray


def rind_contents(path: PigmentPath, states: FloatArray) -> dict[str, FloatArray]:
    """Contents `(s,)` of a rind at states `(s,)`: "chlorophyll" and "carotenoids", ug per cm2 of skin.

    Carotenoids are those of green tissue and the red ones of ripe fruit (`capsanthin_ug_cm2`). The flesh
    below the rind has no pigments. It is as thick as its light goes, so there is no water per area.
    """
    contents = path.at(states)
    return {
        "chlorophyll": contents["chlorophyll_ug_cm2"],
        "carotenoids": contents["carotenoid_ug_cm2"] + contents["capsanthin_ug_cm2"],
    }


def leaf_contents(path: PigmentPath, states: FloatArray) -> dict[str, FloatArray]:
    """Contents `(s,)` of a sheet: those of `rind_contents`, and "water", the equivalent thickness in cm."""
    return {**rind_contents(path, states), "water": path.at(states)["water_cm"]}
