"""The file of a tuned cultivar: it extends the one that was tuned and restates the pigments that changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar.structure import PigmentPath, Pigments
from pepperscene.tuning.output.provenance import RunInfo, colours_told, values_told
from pepperscene.tuning.output.toml_text import document, rounded

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar
    from pepperscene.tuning.fit.result import FitResult
    from pepperscene.tuning.parameters.parameter import Parameter


_TOLERANCE: Final = 1e-6
"""Of a content's range along its path, by which it may move where a knot is left out."""
_SAME: Final = 1e-9  # relative; below, a path has not changed


def changed(cultivar: Cultivar, pigments: Mapping[str, PigmentPath]) -> dict[str, PigmentPath]:
    """The paths that differ from the cultivar's own, by surface, in the cultivar's order."""
    return {
        name: pigments[name]
        for name, path in cultivar.pigments.items()
        if name in pigments and not _alike(path, pigments[name])
    }


def thinned(path: PigmentPath) -> PigmentPath:
    """The path with the fewest of its knots that keep every content to a millionth of its range."""
    states = np.array([state for state, _ in path.knots])
    contents = np.array([[getattr(at, name) for name in Pigments.model_fields] for _, at in path.knots])
    most = _TOLERANCE * np.ptp(contents, axis=0) + 1e-12 * np.abs(contents).max(axis=0)
    kept = _fewest(states, contents, most)
    return path.model_copy(update={"path": tuple(path.knots[i] for i in kept[1:-1])})


def cultivar_text(
    cultivar: Cultivar, extends: str, pigments: Mapping[str, PigmentPath], fit: FitResult, occasion: RunInfo
) -> str:
    """The TOML of a cultivar with other pigments.

    Args:
        cultivar: as its own file has it.
        extends: how the new file names that file.
        pigments: paths that changed, by surface; thinned here.
        fit: that changed them.
        occasion: when and to what.
    """
    surfaces = " and ".join(pigments)
    tables = {
        "extends": extends,
        "name": f"{cultivar.name}, tuned",
        "source": f"{cultivar.source}; the pigments of {surfaces}: tuned, as stated there",
        "pigments": {
            name: _path_table(name, path, cultivar.pigments[name], fit, occasion)
            for name, path in pigments.items()
        },
    }
    head = (
        f"{cultivar.name} with the pigments of {surfaces} tuned to measured colour; all else is inherited.\n"
        f"{occasion.told()}.\n{colours_told(fit)}."
    )
    return document(tables, head=head, deep=2)


def parameters_of_surface(fit: FitResult, surface: str) -> tuple[Parameter, ...]:
    """The fitted parameters that a surface's pigments depend on."""
    return tuple(one for one in fit.parameters if one.name.partition(".")[0] == surface)


def _path_table(
    name: str, path: PigmentPath, before: PigmentPath, fit: FitResult, occasion: RunInfo
) -> dict[str, Any]:
    """A path as files write it."""
    values = "; ".join(values_told(fit, one) for one in parameters_of_surface(fit, name))
    was = f". Before that: {before.source}" if before.source.strip() else ""
    table: dict[str, Any] = {"source": f"{occasion.told()}: {values}{was}"}
    for key in ("chosen", "as_printed", "used"):
        if said := getattr(before, key).strip():
            table[key] = f"Before it was tuned: {said}"
    if path.flesh_reflectance is not None:
        table["flesh_reflectance"] = float(path.flesh_reflectance)
    table |= {"ior": float(path.ior), "roughness": [float(alpha) for alpha in path.roughness]}
    few = thinned(path)
    table |= {"start": _contents(few.start), "end": _contents(few.end)}
    if few.path:
        table["path"] = [[float(state), _contents(at)] for state, at in few.path]
    return table


def _contents(pigments: Pigments) -> dict[str, float]:
    """Contents that are not what a file leaves out."""
    told = {name: rounded(getattr(pigments, name)) for name in Pigments.model_fields}
    fields = Pigments.model_fields
    return {n: v for n, v in told.items() if fields[n].is_required() or v != fields[n].default}


def _alike(one: PigmentPath, other: PigmentPath) -> bool:
    """Whether two paths are the same at every state, and the bodies and cuticles with them."""
    states = sorted({state for path in (one, other) for state, _ in path.knots})
    a, b = (np.array(list(path.at(states).values())) for path in (one, other))
    if not np.allclose(a, b, rtol=_SAME, atol=_SAME * max(float(np.abs(a).max()), 1e-300) * 1e-3):
        return False
    flesh = (one.flesh_reflectance, other.flesh_reflectance)
    if flesh[0] is None or flesh[1] is None:
        same_flesh = flesh[0] is flesh[1]
    else:
        same_flesh = abs(flesh[0] - flesh[1]) <= _SAME
    return same_flesh and bool(
        np.allclose([one.ior, *one.roughness], [other.ior, *other.roughness], rtol=_SAME, atol=0.0)
    )


def _fewest(
    states: NDArray[np.float64], contents: NDArray[np.float64], most: NDArray[np.float64]
) -> Sequence[int]:
    """Indices of the fewest knots, ends included, between which no content is off by more than `most`.

    A step may lead from knot i to knot j if the line between them passes all in between closely enough, and
    the fewest steps from the first knot to the last are the shortest way (Imai & Iri 1988).
    """
    count = len(states)
    steps, before = [0, *[count] * (count - 1)], [0] * count
    for j in range(1, count):
        for i in range(j):
            if steps[i] + 1 < steps[j] and _passes(states, contents, most, i, j):
                steps[j], before[j] = steps[i] + 1, i
    kept = [count - 1]
    while kept[-1]:
        kept.append(before[kept[-1]])
    return kept[::-1]


def _passes(
    states: NDArray[np.float64], contents: NDArray[np.float64], most: NDArray[np.float64], i: int, j: int
) -> bool:
    share = ((states[i + 1 : j] - states[i]) / (states[j] - states[i]))[:, None]
    line = contents[i] + share * (contents[j] - contents[i])
    return bool((np.abs(line - contents[i + 1 : j]) <= most).all())
