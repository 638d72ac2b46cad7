"""Derivatives of the image: against finite differences, against each other, and in a descent.

Finite differences use the same random numbers. Paths do not depend on the parameters, so the image is a
smooth function of them, and the tolerances are little more than the errors of single precision.
"""

from dataclasses import replace

import numpy as np
import pytest
from bodies import axis_camera, card, sphere

from pepperscene.camera import expected_electrons
from pepperscene.classes import Appearance
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import Surface, lambertian_surface, organ_surfaces
from pepperscene.render.arrays import local_coordinates
from pepperscene.render.gradients import detached_sampling as passes
from pepperscene.render.gradients.renderer import DifferentiableRenderer
from pepperscene.render.kernel.camera import camera_rays, spectral_response
from pepperscene.render.kernel.scene import light_scene
from pepperscene.render.quality import Quality
from pepperscene.render.transport.trace import Sampling, trace
from pepperscene.scene import Sun, assemble_scene, uniform_sky
from pepperscene.spectra import Spectrum

NM = np.arange(380.0, 781.0, 10.0)
SUN = Sun(np.array([0.6, 0.0, -0.8]), Spectrum(NM, np.full(NM.size, 0.5)))
DAY = replace(uniform_sky(Spectrum(NM, 1.0 + 0.001 * (NM - 550.0)), 20_000.0), sun=SUN)
SCALES = {
    "structure_n": 1.5,
    "water_cm": 100.0,
    "dry_matter_g_cm2": 0.01,
    "brown": 0.1,
    "flesh_reflectance": 0.6,
}
"""Sizes of the parameters, for the steps. A leaf's water absorbs a tenth of single precision in the visible:
the step is in decimetres. A dark stem needs 2 cm, for an error of 2e-3, which falls as the step grows."""


def quality(samples: int, bounces: int = 2) -> Quality:
    return Quality(samples, samples, samples, bounces, target=None, denoise=False)


@pytest.fixture(scope="module")
def surfaces(kaite) -> dict[str, Surface]:
    return {**organ_surfaces(kaite, NM), "matt": lambertian_surface("matt", 0.5)}


def leaf_and_fruit(surfaces, sky=DAY):
    """A fruit, a leaf and a scar in front of a wall, all within the 12 x 8 mm that the camera sees."""
    fruit = sphere((0.002, 0.0, 0.45), 0.003, "fruit", subdivisions=4)
    leaf, scar = card(-0.009, 0.0, 0.015, 0.06, "leaf", 0.43), card(0.006, 0.003, 0.004, 0.004, "cut", 0.46)
    mesh = concatenate_meshes([fruit, leaf, scar, card(0.0, 0.0, 1.0, 1.0, "matt")])
    return assemble_scene(mesh, surfaces, sky)


@pytest.fixture(scope="module")
def camera():
    return axis_camera(24, 16)


@pytest.fixture(scope="module")
def renderer(surfaces, camera, kaite):
    return DifferentiableRenderer(leaf_and_fruit(surfaces), camera, kaite, quality(16), seed=3)


def slope_by_differences(renderer, name, direction, step):
    """Central differences, one-sided at a lower limit, with Richardson extrapolation.

    The error is of the fourth order in the step (the third if one-sided).
    """
    value = renderer.parameters[name]
    lowest = {"structure_n": 1.0}.get(name.rpartition(".")[2], 0.0)

    def slope(h):
        if (value - h * direction >= lowest).all():
            above, below = (renderer.rgb({name: value + sign * h * direction}) for sign in (1, -1))
            return (above - below) / (2 * h)
        at, once, twice = (renderer.rgb({name: value + k * h * direction}) for k in (0, 1, 2))
        return (4 * once - 3 * at - twice) / (2 * h)

    return (4 * slope(step / 2) - slope(step)) / 3


def test_image_equals_that_of_the_renderer(surfaces, camera, kaite):
    """Exact for direct light: no path is long enough to end at random."""
    scene = leaf_and_fruit(surfaces, sky=None)
    spectral = spectral_response(camera, scene)
    kernel_scene = light_scene(scene, float(spectral.grid_nm[0]), float(spectral.grid_nm[-1]))
    rays = camera_rays(camera, local_coordinates(scene.mesh))
    light = trace(kernel_scene, rays, spectral, camera.flash, None, Sampling(8, 8, 0), seed=5)
    expected = expected_electrons(light.total(), camera)
    result = DifferentiableRenderer(scene, camera, kaite, quality(8, 0), seed=5).rgb()
    assert result == pytest.approx(expected, rel=1e-5, abs=1e-5 * expected.max())


@pytest.mark.long
def test_changed_parameters_give_the_image_of_the_changed_scene(surfaces, camera, kaite):
    """Paths sampled for one scene and evaluated for another keep the mean of the light.

    Over 24 seeds within 4 standard errors, without a flash, for a rougher, greener leaf and a duller fruit.
    """
    tuned = {"leaf.roughness": [0.7, 0.3], "leaf.chlorophyll_ug_cm2": 15.0, "fruit.roughness": 0.3}
    paths = dict(kaite.pigments)
    green = {"chlorophyll_ug_cm2": 15.0}
    leaf = paths["leaf"]
    changes = {name: getattr(leaf, name).model_copy(update=green) for name in ("start", "end")}
    changes["path"] = tuple((state, pigments.model_copy(update=green)) for state, pigments in leaf.path)
    paths["leaf"] = leaf.model_copy(update={**changes, "roughness": (0.7, 0.3)})
    paths["fruit"] = paths["fruit"].model_copy(update={"roughness": (0.3, 0.3)})
    other = kaite.model_copy(update={"pigments": paths})
    # Both have the same number of rows of spectra, and are linear between them.
    changed = {**surfaces, **{n: s for n, s in organ_surfaces(other, NM).items() if n in ("leaf", "fruit")}}
    dark = replace(camera, flash=None)

    def means(surfaces, cultivar, values):
        scene = leaf_and_fruit(surfaces)
        renderers = (DifferentiableRenderer(scene, dark, cultivar, quality(16), seed=k) for k in range(24))
        return np.array([renderer.rgb(values).mean((0, 1)) for renderer in renderers])

    result, expected = means(surfaces, kaite, tuned), means(changed, other, {})
    error = np.hypot(result.std(axis=0, ddof=1), expected.std(axis=0, ddof=1)) / np.sqrt(24)
    assert (np.abs(result.mean(axis=0) - expected.mean(axis=0)) <= 4 * error.max()).all()
    before = means(surfaces, kaite, {}).mean(axis=0)
    assert (np.abs(before - expected.mean(axis=0)) > 20 * error).all()


@pytest.mark.parametrize(
    "name",
    ["flash.power", pytest.param("flash.spectrum", marks=pytest.mark.long), "exposure.time", "exposure.gain"],
)
def test_slopes_of_linear_parameters(renderer, name):
    """A single step of a tenth is exact, to the 1e-5 of single precision over that step."""
    value = renderer.parameters[name]
    direction = np.random.default_rng(7).uniform(0.5, 1.5, value.shape)
    slope = renderer.forward({}, {name: direction})
    above, below = (renderer.rgb({name: value + h * direction}) for h in (0.1, -0.1))
    assert slope == pytest.approx((above - below) / 0.2, abs=1e-4 * slope.max())


def test_slope_of_the_f_number(renderer):
    """The image is proportional to N^-2, so N times its slope is -2 times the image."""
    n = renderer.parameters["exposure.f_number"]
    image = renderer.rgb()
    assert n * renderer.forward({}, {"exposure.f_number": 1.0}) == pytest.approx(-2 * image, rel=1e-6)
    assert renderer.rgb({"exposure.f_number": 2 * n}) == pytest.approx(image / 4, rel=1e-12)


PARAMETERS = (
    "structure_n", "chlorophyll_ug_cm2", "carotenoid_ug_cm2", "capsanthin_ug_cm2", "anthocyanin_ug_cm2",
    "brown", "water_cm", "dry_matter_g_cm2", "flesh_reflectance", "ior", "roughness",
)  # fmt: skip
IN_CI = {
    "leaf": {"structure_n", "chlorophyll_ug_cm2", "water_cm", "ior"},
    "fruit": {"structure_n", "carotenoid_ug_cm2", "flesh_reflectance", "roughness"},
    "stem": {"dry_matter_g_cm2"},
}
"""Both kinds of body, each kind of pigment, and the cuticle."""
SLOPES = [
    pytest.param(surface, parameter, marks=() if parameter in chosen else pytest.mark.long)
    for surface, chosen in IN_CI.items()
    for parameter in PARAMETERS
]


@pytest.mark.parametrize(("surface", "parameter"), SLOPES)
def test_slopes_of_pigments_and_cuticles(renderer, surface, parameter):
    """Forward and reverse against differences.

    Steps of 2 % and 1 % leave an error of 1e-3 where slopes are so small that single precision matters in the
    difference, and where PROSPECT behaves as k log k without absorption; a wrong factor in any term would be
    larger. The stem has no triangles here and appears in the scar's rim only.
    """
    name = f"{surface}.{parameter}"
    if name not in renderer.parameters:
        assert name == "leaf.flesh_reflectance"
        return
    value = renderer.parameters[name]
    # Not the same for all knots, nor for both sides.
    direction = np.linspace(1.0, 0.5, value.size).reshape(value.shape)
    scale = max(np.abs(value).max(), SCALES.get(parameter, 1.0 if parameter.endswith("cm2") else 0.0))
    differences = slope_by_differences(renderer, name, direction, 0.02 * scale)
    forward = renderer.forward({}, {name: direction})
    assert np.linalg.norm(forward - differences) <= 5e-3 * np.linalg.norm(differences)
    assert np.abs(forward - differences).max() <= 2e-2 * np.abs(differences).max()
    reverse = renderer.backward({name: value}, np.ones_like(forward))
    assert reverse.keys() == {name}
    error = (reverse[name] * direction).sum() - differences.sum()
    assert abs(error) <= 5e-3 * np.abs(differences).sum()


@pytest.mark.parametrize("parameter", [pytest.param("ior", marks=pytest.mark.long), "roughness"])
def test_slopes_of_a_cuticle_with_two_lobes_and_a_filtered_relief(camera, parameter):
    """The second lobe, residue and the blur of the relief are constant, but the tables change with all."""
    x = np.linspace(0.0, 2.0 * np.pi, 128, endpoint=False)
    relief = (0.01 * np.sin(40 * x)[None] * np.ones((128, 1))).astype(np.float32)
    wall = Surface(
        "wall", NM[[0, -1]], np.full((1, 2, 2), 0.3), np.full((1, 2), 0.2), 1.45, (0.2, 0.3),
        wide_roughness=(0.6, 0.7), wide_share=0.4, relief_mm=relief[None],
    )  # fmt: skip
    mesh = card(0.0, 0.0, 0.05, 0.05, "wall")
    mesh = replace(mesh, uv=(mesh.vertices[:, :2] / 0.05 + 0.5).astype(np.float32))
    mesh = replace(mesh, appearances=(Appearance(residue=0.3),))
    renderer = DifferentiableRenderer(assemble_scene(mesh, {"wall": wall}, DAY), camera, None, quality(16), 3)
    name = f"wall.{parameter}"
    value = renderer.parameters[name]
    direction = np.linspace(1.0, 0.5, value.size).reshape(value.shape)
    differences = slope_by_differences(renderer, name, direction, 0.02 * value.max())
    forward = renderer.forward({}, {name: direction})
    assert np.linalg.norm(forward - differences) <= 5e-3 * np.linalg.norm(differences)
    error = (
        renderer.backward({name: value}, np.ones_like(forward))[name] * direction
    ).sum() - differences.sum()
    assert abs(error) <= 5e-3 * np.abs(differences).sum()


def test_reverse_is_the_transpose_of_forward(renderer):
    """g . (J d) = (J^T g) . d for some parameters and all together, to the 1e-5 of single precision."""
    rng = np.random.default_rng(11)
    image_gradient = rng.normal(size=renderer.rgb().shape)
    reverse = renderer.backward(renderer.parameters, image_gradient)
    assert list(reverse) == list(renderer.parameters)
    directions = {
        name: rng.normal(size=value.shape) * np.maximum(np.abs(value), 0.1)
        for name, value in renderer.parameters.items()
    }
    for one in (*({name: direction} for name, direction in list(directions.items())[::4]), directions):
        assert all(reverse[name].shape == direction.shape for name, direction in one.items())
        terms = renderer.forward({}, one) * image_gradient
        expected = sum((reverse[name] * direction).sum() for name, direction in one.items())
        assert terms.sum() == pytest.approx(expected, abs=1e-5 * np.abs(terms).sum())


def test_gradients_add_up_over_passes(renderer, monkeypatch):
    """Passes of 40 pixels, the last of them shorter, against a single one."""
    image_gradient = np.random.default_rng(2).uniform(size=renderer.rgb().shape)
    name = "fruit.carotenoid_ug_cm2"
    value = {name: renderer.parameters[name]}
    reverse, forward = renderer.backward(value, image_gradient)[name], renderer.forward({}, {name: 1.0})
    monkeypatch.setattr(passes, "_LANES", 40 * 16)
    assert renderer.backward(value, image_gradient)[name] == pytest.approx(reverse, rel=1e-5)
    assert renderer.forward({}, {name: 1.0}) == pytest.approx(forward, rel=1e-6, abs=1e-6)


WHITE = {f"leaf.{name}": 0.0 for name in (
    "chlorophyll_ug_cm2", "carotenoid_ug_cm2", "capsanthin_ug_cm2", "anthocyanin_ug_cm2", "brown", "water_cm",
    "dry_matter_g_cm2",
)}  # fmt: skip
BLACK = {"leaf.chlorophyll_ug_cm2": 1e4, "leaf.brown": 1e3, "leaf.dry_matter_g_cm2": 10.0}


@pytest.mark.parametrize(
    "values",
    [
        pytest.param(WHITE, id="R + T is 1", marks=pytest.mark.long),
        pytest.param(
            BLACK | {"leaf.ior": 2.5, "leaf.roughness": 1.0}, id="all gloss", marks=pytest.mark.long
        ),
        pytest.param({"leaf.roughness": 1e-3, "fruit.roughness": 1e-3}, id="mirrors"),
        pytest.param({"leaf.ior": 1.0, "fruit.ior": 1.0}, id="no gloss", marks=pytest.mark.long),
        pytest.param({"fruit.flesh_reflectance": 0.0}, id="black flesh", marks=pytest.mark.long),
    ],
)
def test_gradients_are_finite_for_extreme_parameters(renderer, values):
    image = renderer.rgb(values)
    assert np.isfinite(image).all()
    assert image.min() >= 0
    parameters = {**renderer.parameters, **values}
    reverse = renderer.backward(parameters, np.ones_like(image))
    assert reverse.keys() == parameters.keys()
    assert all(np.isfinite(slope).all() for slope in reverse.values())
    forward = renderer.forward(values, dict.fromkeys(renderer.parameters, 1.0))
    assert np.isfinite(forward).all()
    total = sum(slope.sum() for slope in reverse.values())
    assert forward.sum() == pytest.approx(total, abs=1e-4 * np.abs(forward).sum())


def test_gradients_without_light_are_zero(surfaces, camera, kaite):
    scene = leaf_and_fruit(surfaces, None)
    dark = DifferentiableRenderer(scene, replace(camera, flash=None), kaite, quality(4))
    assert "flash.power" not in dark.parameters
    assert (dark.rgb() == 0).all()
    assert (dark.forward({}, {"leaf.brown": 1.0, "exposure.gain": 1.0}) == 0).all()
    assert not any(slope.any() for slope in dark.backward(dark.parameters, np.ones((16, 24, 3))).values())


@pytest.mark.parametrize("start", [0.5, pytest.param(2.0, marks=pytest.mark.long)])
def test_descent_recovers_the_chlorophyll_of_a_leaf(surfaces, kaite, start):
    """From half and twice the content, for an image with other random numbers, to 2 %.

    Gradient descent with the step size of Barzilai & Borwein (1988).
    """
    mesh = concatenate_meshes([card(0.0, 0.0, 0.06, 0.06, "leaf", 0.44), card(0.0, 0.0, 1.0, 1.0, "matt")])
    scene = assemble_scene(mesh, surfaces)
    target, renderer = (
        DifferentiableRenderer(scene, axis_camera(8, 8), kaite, quality(16, 1), seed=seed) for seed in (1, 2)
    )
    target, name = target.rgb(), "leaf.chlorophyll_ug_cm2"
    true = renderer.parameters[name]

    def error_slope(factor):
        residual = (renderer.rgb({name: factor * true}) - target) / target.mean()
        gradient = renderer.backward({name: factor * true}, 2.0 * residual / target.mean())
        return float(gradient[name] @ true)

    factors = [start, 0.9 * start + 0.1]
    slopes = [error_slope(factors[0])]
    for _ in range(10):
        slopes.append(error_slope(factors[-1]))
        curvature = (slopes[-1] - slopes[-2]) / (factors[-1] - factors[-2])
        step = np.clip(-slopes[-1] / abs(curvature), -0.3, 0.3)
        factors.append(float(factors[-1] + step))
        if abs(step) < 1e-4:
            break
    assert factors[-1] == pytest.approx(1.0, abs=0.02), factors


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"leaf.clorophyll": 1.0}, "unknown parameter 'leaf.clorophyll'"),
        ({"leaf.roughness": [0.1, 0.2, 0.3]}, "must have the shape"),
        ({"leaf.roughness": 0.0}, "must be finite and between"),
        ({"fruit.brown": float("nan")}, "must be finite and between"),
        ({"flash.power": 0.0}, "must be above 0"),
        ({"exposure.f_number": float("inf")}, "be finite"),
    ],
)
def test_rejects_invalid_parameters(renderer, values, message):
    with pytest.raises(ValueError, match=message):
        renderer.rgb(values)


def test_rejects_surfaces_of_another_cultivar(surfaces, camera):
    with pytest.raises(ValueError, match="not what this cultivar's pigments make"):
        DifferentiableRenderer(leaf_and_fruit(surfaces), camera, load_cultivar("red_blocky"), quality(4))
