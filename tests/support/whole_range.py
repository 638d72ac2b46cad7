"""Cultivars and recipes over the whole range that validation admits, drawn by the models' own bounds."""

from __future__ import annotations

import copy
import math
import typing
from functools import cache, partial

from annotated_types import Ge, Gt, Le, Lt
from hypothesis import strategies as st
from pydantic import AfterValidator, BaseModel, BeforeValidator
from pydantic.fields import FieldInfo

from pepperscene.cultivar import Cultivar, Distribution, PigmentPath, Pigments, Stem
from pepperscene.cultivar.inheritance import merge_chain, read_chain
from pepperscene.cultivar.notation import NUMBERS, Number
from pepperscene.cultivar.organs import MODELS, ResidueShares
from pepperscene.cultivar.slot import Slot
from pepperscene.document import validate
from pepperscene.recipe.recipe import Recipe
from pepperscene.units import is_table, table_fields

WIDEST = {"mm": 1e6, "deg": 1e6, "": 1e6}
"""The greatest number of a file, by unit (`pepperscene.cultivar.notation`)."""
_ABOVE = 1e-7
"""The least number that is drawn of parameters that must be above 0."""
BASES = {
    "leaf": ("petiole", "lamina"), "fruit": ("peduncle", "fruit"), "flower": ("pedicel", "flower"),
    "cut": ("cut",),
}  # fmt: skip
"""What grows at the nodes of a drawn cultivar: kinds of `kaite`, each on the one before."""
NOT_DRAWN = {
    # Structure, which `BASES` and the slots of nodes give.
    "form", "bears", "internode", "node", "parts", "young_nodes",
    # Texts.
    "surface", "source", "chosen", "as_printed", "used",
    # Files.
    "scan", "scan_weights", "scan_up", "scan_unit", "scan_colour",
}  # fmt: skip
"""Fields of a cultivar that are not numbers, switches or choices."""


def ends_of(field: FieldInfo) -> tuple[float, float]:
    """The least and the greatest number of a field; infinite without a bound."""
    low, high = -math.inf, math.inf
    for meta in _metadata(field):
        if isinstance(meta, Ge | Gt):
            low = max(low, float(meta.ge if isinstance(meta, Ge) else meta.gt))
        if isinstance(meta, Le | Lt):
            high = min(high, float(meta.le if isinstance(meta, Le) else meta.lt))
    return low, high


def _metadata(field: FieldInfo) -> list[object]:
    found, queue = [], [*field.metadata, *typing.get_args(field.annotation)]
    while queue:
        part = queue.pop(0)
        inner = getattr(part, "metadata", None) or getattr(part, "__metadata__", None)
        if isinstance(part, Ge | Gt | Le | Lt | BeforeValidator | AfterValidator):
            found.append(part)
        elif inner is not None:
            queue.extend(inner)
    return found


def types_of(field: FieldInfo) -> list[object]:
    """The types of a field without their bounds, and without None."""
    parts = typing.get_args(field.annotation)
    is_optional = type(None) in parts
    options = [part for part in parts if part is not type(None)] if is_optional else [field.annotation]
    return [typing.get_args(part)[0] if hasattr(part, "__metadata__") else part for part in options]


def numbers_between(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers of a range: its ends, all magnitudes between, and 0."""
    low, high = max(low, -1e6), min(high, 1e6)
    ends = [low, high, math.nextafter(low, math.inf), math.nextafter(high, -math.inf)]
    ends += [0.0] if low <= 0 <= high else []
    sizes = (1e-300, 1e-9, 1e-6, 1e-4, 1e-3, 0.01, 0.1, 1.0, 10.0, 100.0, 1e3, 1e5)
    ends += [sign * size for size in sizes for sign in (1.0, -1.0) if low <= sign * size <= high]
    return st.one_of(st.sampled_from(ends), st.floats(low, high, allow_subnormal=False))


@st.composite
def distributions(draw, unit: str, low: float, high: float) -> dict:
    """Table of a distribution whose values are within the bounds of its field, in units of the file."""
    suffix = f"_{unit}" if unit else ""
    values = numbers_between(low, high)
    family = draw(st.sampled_from(["value", "value", "value", "uniform", "normal", "histogram"]))
    if family == "value":
        return {f"value{suffix}": draw(values), "chosen": "drawn"}
    first, last = sorted((draw(values), draw(values)))
    if not last - first > 1e-6 * max(abs(first), abs(last), 1e-6):
        return {f"value{suffix}": last, "chosen": "drawn"}
    if family == "uniform":
        return {f"uniform{suffix}": [first, last], "chosen": "drawn"}
    if family == "histogram":
        middle = 0.5 * (first + last)
        return {f"histogram{suffix}": [[first, middle, 0.25], [middle, last, 0.75]], "chosen": "drawn"}
    mean, sd = 0.5 * (first + last), 0.2 * (last - first)
    ends = {f"low{suffix}": first, f"high{suffix}": last}
    return {f"mean{suffix}": mean, f"sd{suffix}": sd, **ends, "chosen": "drawn"}


def field_values(name: str, field: FieldInfo) -> st.SearchStrategy | None:
    """Values of a field of a cultivar's model, as in its file; None for those of `NOT_DRAWN`."""
    if name in NOT_DRAWN:
        return None
    annotation = field.annotation
    options = types_of(field)
    if Distribution in (annotation, *options):
        return _of_distribution(field)
    if annotation is bool:
        return st.booleans()
    if typing.get_origin(options[0]) is typing.Literal:
        return st.sampled_from(typing.get_args(options[0]))
    if annotation is Number:
        words = NUMBERS[1:5] if name == "lobes" else NUMBERS
        return st.sampled_from([{word: 1.0, "chosen": "drawn"} for word in words])
    if options[0] in (int, float):
        low, high = ends_of(field)
        if options[0] is int:
            return st.integers(int(low), int(high))
        return numbers_between(low, high)
    if annotation is ResidueShares:
        parts = st.permutations([0.0, 0.3, 0.7])
        return parts.map(lambda row: dict(zip(("dust", "spray", "mildew"), row, strict=True)))
    raise TypeError(f"{name}: no values are drawn for {annotation}; add it here, or to NOT_DRAWN")


def _of_distribution(field: FieldInfo) -> st.SearchStrategy:
    unit, low, high = "", -math.inf, math.inf
    for meta in _metadata(field):
        function = getattr(meta, "func", None)
        if isinstance(meta, BeforeValidator) and isinstance(function, partial):
            unit = function.args[0]
        if isinstance(meta, AfterValidator) and isinstance(function, partial):
            low = max(low, function.keywords.get("minimum", -math.inf))
            low += _ABOVE if function.keywords.get("exclusive") else 0.0
            high = min(high, function.keywords.get("maximum", math.inf))
    scale = {"mm": 1e3, "deg": 180.0 / math.pi, "": 1.0}[unit]
    return distributions(unit, max(low * scale, -WIDEST[unit]), min(high * scale, WIDEST[unit]))


@st.composite
def changed_fields(draw, model: type[BaseModel], most: int) -> dict:
    """New values of a few fields of a model."""
    fields = {name: field_values(name, field) for name, field in model.model_fields.items()}
    drawn = [name for name, values in fields.items() if values is not None]
    names = draw(st.lists(st.sampled_from(drawn), max_size=most, unique=True)) if drawn else []
    changed = {name: draw(fields[name]) for name in names}
    return {"class" if name == "organ_class" else name: value for name, value in changed.items()}


def plain_tables(grown: str, count: str = "one", slots: int = 1) -> dict:
    """Tables of a cultivar whose nodes bear one thing of `BASES`: `slots` times `count` at each node."""
    tables = copy.deepcopy(_kaite())
    kinds = ("internode", "node", *BASES[grown])
    tables["organs"] = {name: tables["organs"][name] for name in kinds}
    tables["organs"]["node"]["bears"] = [
        {
            "name": f"grown {number}",
            "what": {BASES[grown][0]: 1, "chosen": "drawn"},
            "count": {count: 1, "chosen": "drawn"},
            "azimuth": {"uniform_deg": [0, 360], "chosen": "drawn"},
        }
        for number in range(slots)
    ]
    tables["stem"] |= {"parts": 1, "young_nodes": 0}
    return tables


@st.composite
def cultivar_tables(draw) -> dict:
    """Tables of a cultivar with few organs, whose parameters are drawn from their whole range."""
    grown, count = draw(st.sampled_from(sorted(BASES))), draw(st.sampled_from(["one", "two", "twelve"]))
    tables = plain_tables(grown, count)
    for organ in tables["organs"].values():
        organ |= draw(changed_fields(MODELS[organ["form"]], 3))
    slot = tables["organs"]["node"]["bears"][0]
    for name in ("spread", "lift"):
        slot[name] = draw(field_values(name, Slot.model_fields[name]))
    path = tables["pigments"][draw(st.sampled_from(sorted(tables["pigments"])))]
    path["end"] |= draw(changed_fields(Pigments, 3))
    path |= draw(changed_pigment_path())
    tables["stem"] |= draw(changed_fields(Stem, 2))
    tables["stem"] |= {"parts": draw(st.integers(1, 3)), "young_nodes": draw(st.integers(0, 3))}
    return tables


@st.composite
def changed_pigment_path(draw) -> dict:
    """New values of the optics of a surface."""
    fields = PigmentPath.model_fields
    changed = {name: draw(numbers_between(*ends_of(fields[name]))) for name in ("ior", "wide_share")}
    for name in ("roughness", "wide_roughness"):
        changed[name] = [draw(st.floats(1e-300, 1.0)), draw(st.sampled_from([1e-9, 0.01, 1.0]))]
    names = draw(st.lists(st.sampled_from(sorted(changed)), max_size=2, unique=True))
    return {name: changed[name] for name in names}


def cultivar_of(tables: dict) -> Cultivar:
    """The validated cultivar; raises `InputError`."""
    return validate(Cultivar, tables, "drawn")


@cache
def _kaite() -> dict:
    return merge_chain(read_chain("kaite"))


KEPT = {
    # What makes scenes and images large.
    "row.plants_front", "row.plants_back", "camera.width", "camera.height", "greenhouse.far_reach_mm",
    "greenhouse.far_rows", "plan.sets", "plan.rotations", "plan.frames", "plan.twins", "plan.cameras",
    "growth.share", "seed",
    # Given together only.
    "camera.fx", "camera.fy", "camera.cx", "camera.cy",
}  # fmt: skip


def recipe_keys(model: type = Recipe, above: str = "") -> dict[str, FieldInfo]:
    """Dotted key and field of every number and switch of a recipe, and of the tables inside it."""
    found = {}
    for name, annotation in table_fields(model).items():
        key, field = f"{above}{name}", FieldInfo.from_annotation(annotation)
        tables = [part for part in [annotation, *typing.get_args(annotation)] if is_table(part)]
        if tables:
            found |= recipe_keys(tables[0], f"{key}.")
        elif key not in KEPT and not key.startswith("depth_camera."):
            found |= {key: field} if set(types_of(field)) & {int, float, bool} else {}
    return found


@st.composite
def recipe_changes(draw) -> dict:
    """New values of a few keys of a recipe."""
    keys = recipe_keys()
    changes = {}
    names = draw(st.lists(st.sampled_from(sorted(keys)), max_size=2, unique=True))
    for key in names:
        if key.startswith("views."):
            continue
        field = keys[key]
        options = types_of(field)
        if bool in options:
            changes[key] = draw(st.booleans())
            continue
        low, high = ends_of(field)
        if int in options and float not in options:
            changes[key] = draw(st.integers(int(max(low, -(2**40))), int(min(high, 2**40))))
        else:
            changes[key] = draw(numbers_between(low, high))
    return changes
