"""A fit result made by hand, with everything that a fit can have."""

from __future__ import annotations

import numpy as np

from pepperscene.colour import MeasuredSpectrum, Patch, PatchSet, linear_srgb_to_lab
from pepperscene.recipe.resolve.load_camera import load_camera
from pepperscene.recipe.resolve.resolved import load_recipe_cultivar
from pepperscene.spectra import Spectrum
from pepperscene.tuning.least_squares import FitResult, KindFit, SpectrumFit, Start
from pepperscene.tuning.parameters import select_parameters
from pepperscene.tuning.tuned import tuned_parts

VALUES = {
    "leaf.chlorophyll": [48.123456789],
    "leaf.roughness": [0.41],
    "fruit.ripeness": [0.62],
    "flash.power": [1.17],
    "flash.colour": [0.21, -0.08],
    "exposure": [0.83],
    "white_balance": [1.06, 0.93],
    "colour_matrix": [-0.5, -0.1, -0.2, -0.4, 0.02, -0.6],
}
NODES_NM = np.linspace(391.0, 729.0, 8)
"""As of a renderer: not at whole nanometres."""


def example_fit(recipe, values=None, *, pixels=300) -> FitResult:
    """The result of a fit of a recipe with these values."""
    values = {name: np.array(value) for name, value in (VALUES if values is None else values).items()}
    cultivar, camera = load_recipe_cultivar(recipe), load_camera(recipe)
    parameters = select_parameters(recipe, cultivar, camera, tuple(values))
    entries = sum(len(one.labels) for one in parameters)
    rng = np.random.default_rng(5)
    correlation = np.eye(entries)
    correlation[0, -1] = correlation[-1, 0] = 0.5 if entries > 1 else 1.0
    return FitResult(
        parameters=parameters,
        values=values,
        sd={name: 0.02 * np.abs(value) + 1e-3 for name, value in values.items()},
        variance_reduction={name: np.linspace(0.3, 0.99, value.size) for name, value in values.items()},
        correlation=correlation,
        undetermined=("leaf.roughness cannot be determined: its posterior sd is 0.1, its prior sd 0.1",),
        kinds={
            kind: _kind_fit(rng, pixels, *colours)
            for kind, colours in {
                "leaf": ((0.05, 0.09, 0.03), (0.09, 0.11, 0.02), (0.052, 0.088, 0.031)),
                "pepper.ripe": ((0.5, 0.32, 0.01), (0.35, 0.3, 0.02), (0.48, 0.33, 0.012)),
                "peduncle": ((0.12, 0.2, 0.06), (0.13, 0.2, 0.05), (0.121, 0.2, 0.058)),
            }.items()
        },
        spectra={"green pepper": _spectrum_fit()},
        starts=(Start({"leaf.chlorophyll": (62.0,)}, 812.5, 11, "ftol"), Start({}, float("inf"), 30, "most")),
        chi_squared=24.0,
        data_count=18,
        omitted={"camera": 0.4, "light": float("nan")},
        diagnostics=("The model fits the patches: RMS residuals are 1.15 times the expected size.",),
        tuned_parts=tuned_parts(cultivar, camera, values, NODES_NM if camera.flash is not None else ()),
    )


def example_patches() -> PatchSet:
    """Two patches and a spectrum."""
    rng = np.random.default_rng(7)
    codes = [rng.integers(0, 256, (12, 3)).astype(np.uint8) for _ in range(2)]
    nm = np.arange(400.0, 701.0, 10.0)
    return PatchSet(
        "greenhouse, 3 March",
        tuple(
            Patch(f"{kind} 1", kind, "one.png", code / 255.0, code)
            for kind, code in zip(("leaf", "pepper.ripe"), codes, strict=True)
        ),
        (MeasuredSpectrum("green pepper", "pepper.unripe", Spectrum(nm, np.full(nm.size, 0.2), "hold")),),
    )


def _kind_fit(rng, pixels, *colours) -> KindFit:
    clouds = [np.clip(np.array(c) * rng.lognormal(0.0, 0.35, (pixels, 1)), 0.0, 1.0) for c in colours]
    moments = (
        np.stack([linear_srgb_to_lab(cloud.mean(axis=0)), linear_srgb_to_lab(cloud).std(axis=0)])
        for cloud in clouds
    )
    return KindFit(*moments, 9.3, 0.6, *clouds)


def _spectrum_fit() -> SpectrumFit:
    nm = np.arange(400.0, 701.0, 5.0)
    curve = 0.05 + 0.1 * np.exp(-(((nm - 550.0) / 40.0) ** 2)) + 0.3 / (1.0 + np.exp((690.0 - nm) / 6.0))
    return SpectrumFit(nm, curve, curve * 1.3, curve * 1.01, 0.031, 0.0042)
