"""Derivatives of the picture: against finite differences, against each other, and put to use.

What is compared with differences is the renderer itself with the same random numbers. Its paths do not
depend on the parameters, so a picture is smooth in them, and the tolerances are those of single precision
over the steps, with little room.
"""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from bodies import axis_camera, card, sphere

from pepperscene.camera import load_sensor
from pepperscene.cultivar import Cultivar, load_cultivar
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import Surface, lambertian_surface, organ_surfaces
from pepperscene.materials.organs import leaf_surface
from pepperscene.render.gradients import detached_sampling as passes
from pepperscene.render.gradients.renderer import DifferentiableRenderer
from pepperscene.render.kernel.arrays import local_coordinates
from pepperscene.render.kernel.camera import camera_rays, spectral_response
from pepperscene.render.kernel.scene import light_scene
from pepperscene.render.quality import Quality
from pepperscene.render.transport.trace import Sampling, trace
from pepperscene.scene import Sun, assemble_scene, uniform_sky
from pepperscene.scene.sky import Sky
from pepperscene.spectra import Spectrum

NM = np.arange(380.0, 781.0, 10.0)
SUN = Sun(np.array([0.6, 0.0, -0.8]), Spectrum(NM, np.full(NM.size, 0.5)))
DAY = replace(uniform_sky(Spectrum(NM, 1.0 + 0.001 * (NM - 550.0)), 20_000.0), sun=SUN)
SCALES = {
    "structure_n": 1.5,
    "water_cm": 30.0,
    "dry_matter_g_cm2": 0.01,
    "brown": 0.1,
    "flesh_reflectance": 0.6,
}
"""By which steps are told: of the sizes that the parameters have, or where they are 0 could have. A leaf's
own water takes a tenth of single precision in the visible: here it is told by what decimetres take."""


def quality(samples: int, bounces: int = 2) -> Quality:
    return Quality(samples, samples, samples, bounces, target=None, denoise=False)


@pytest.fixture(scope="module")
def kaite() -> Cultivar:
    return load_cultivar("kaite")


@pytest.fixture(scope="module")
def surfaces(kaite) -> dict[str, Surface]:
    return {**organ_surfaces(kaite, NM), "matt": lambertian_surface("matt", 0.5)}


def bench(surfaces, sky=DAY):
    """A fruit, a leaf and a scar before a wall, all within the 12 x 8 mm that the camera sees."""
    mesh = concatenate_meshes(
        [
            sphere((0.002, 0.0, 0.45), 0.003, "fruit", subdivisions=4),
            card(-0.009, 0.0, 0.015, 0.06, "leaf", z=0.43),
            card(0.006, 0.003, 0.004, 0.004, "cut", z=0.46),
            card(0.0, 0.0, 1.0, 1.0, "matt", z=0.5),
        ]
    )
    return assemble_scene(mesh, surfaces, sky)


@pytest.fixture(scope="module")
def camera():
    return axis_camera(columns=24, rows=16)


@pytest.fixture(scope="module")
def renderer(surfaces, camera, kaite):
    return DifferentiableRenderer(bench(surfaces), camera, kaite, quality(16), seed=3)


def slope_by_differences(renderer, name, direction, step):
    """Central differences, or one-sided where a value may not fall, and Richardson's step from two of them.

    What remains is of the fourth order in the step (the third if one-sided).
    """
    value = renderer.parameters[name]
    lowest = {"structure_n": 1.0}.get(name.rpartition(".")[2], 0.0)

    def slope(h):
        if (value - h * direction >= lowest).all():
            above, below = (renderer.rgb({name: value + sign * h * direction}) for sign in (1, -1))
            return (above - below) / (2 * h)
        here, once, twice = (renderer.rgb({name: value + k * h * direction}) for k in (0, 1, 2))
        return (4 * once - 3 * here - twice) / (2 * h)

    return (4 * slope(step / 2) - slope(step)) / 3


# --- the picture ----------------------------------------------------------------------------------------


def test_the_picture_is_the_renderers_own(surfaces, camera, kaite):
    """Where all light meets one surface, to rounding: no path is long enough to end by chance."""
    scene = bench(surfaces, sky=None)
    spectral = spectral_response(camera, scene)
    built = light_scene(scene, float(spectral.grid_nm[0]), float(spectral.grid_nm[-1]))
    view = camera_rays(camera, local_coordinates(scene.mesh))
    light = trace(built, view, spectral, camera.flash, None, Sampling(8, 8, 0), seed=5)
    from pepperscene.camera import expected_electrons

    expected = expected_electrons(light.total(), camera)
    found = DifferentiableRenderer(scene, camera, kaite, quality(8, 0), seed=5).rgb()
    assert found == pytest.approx(expected, rel=1e-5, abs=1e-5 * expected.max())


def test_other_parameters_give_the_picture_of_the_scene_that_has_them(surfaces, camera, kaite):
    """Drawn for one scene and evaluated for another, light keeps its mean: over 24 seeds within 4 standard
    errors of their difference, with scattered light alone, a rougher leaf and a greener, duller fruit."""
    tuned = {"leaf.roughness": [0.7, 0.3], "leaf.chlorophyll_ug_cm2": 15.0, "fruit.roughness": 0.3}
    paths = dict(kaite.pigments)
    green = {"chlorophyll_ug_cm2": 15.0}
    leaf = paths["leaf"]
    paths["leaf"] = leaf.model_copy(
        update={
            "roughness": (0.7, 0.3),
            "start": leaf.start.model_copy(update=green),
            "path": tuple((state, pigments.model_copy(update=green)) for state, pigments in leaf.path),
            "end": leaf.end.model_copy(update=green),
        }
    )
    paths["fruit"] = paths["fruit"].model_copy(update={"roughness": (0.3, 0.3)})
    other = kaite.model_copy(update={"pigments": paths})
    # With as many rows of spectra as the first has: between rows both are linear.
    changed = {**surfaces, **{n: s for n, s in organ_surfaces(other, NM).items() if n in ("leaf", "fruit")}}
    dark = replace(camera, flash=None)

    def means(surfaces, cultivar, values):
        scene = bench(surfaces)
        return np.array(
            [
                DifferentiableRenderer(scene, dark, cultivar, quality(16), seed=seed).rgb(values).mean((0, 1))
                for seed in range(24)
            ]
        )

    drawn, own = means(surfaces, kaite, tuned), means(changed, other, {})
    error = np.hypot(drawn.std(axis=0, ddof=1), own.std(axis=0, ddof=1)) / np.sqrt(24)
    assert np.abs(drawn.mean(axis=0) - own.mean(axis=0)) == pytest.approx(np.zeros(3), abs=4 * error.max())
    before = means(surfaces, kaite, {}).mean(axis=0)
    assert (np.abs(before - own.mean(axis=0)) > 20 * error).all()


# --- against differences --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["flash.power", "flash.spectrum", "exposure.time", "exposure.gain"])
def test_slopes_by_what_the_picture_is_linear_in(renderer, name):
    """One step of a tenth tells them exactly: to the 1e-5 of single precision over that step."""
    value = renderer.parameters[name]
    direction = np.random.default_rng(7).uniform(0.5, 1.5, value.shape)
    slope = renderer.forward({}, {name: direction})
    above, below = (renderer.rgb({name: value + h * direction}) for h in (0.1, -0.1))
    assert slope == pytest.approx((above - below) / 0.2, abs=1e-4 * slope.max())


def test_slope_by_the_f_number(renderer):
    """The picture goes with N^-2, so that N times its slope is -2 of the picture."""
    n = renderer.parameters["exposure.f_number"]
    picture = renderer.rgb()
    assert n * renderer.forward({}, {"exposure.f_number": 1.0}) == pytest.approx(-2 * picture, rel=1e-6)
    assert renderer.rgb({"exposure.f_number": 2 * n}) == pytest.approx(picture / 4, rel=1e-12)


@pytest.mark.parametrize("surface", ["leaf", "fruit", "stem"])
@pytest.mark.parametrize(
    "what",
    [
        "structure_n", "chlorophyll_ug_cm2", "carotenoid_ug_cm2", "capsanthin_ug_cm2", "anthocyanin_ug_cm2",
        "brown", "water_cm", "dry_matter_g_cm2", "flesh_reflectance", "ior", "roughness",
    ],
)  # fmt: skip
def test_slopes_by_pigments_and_cuticles(renderer, surface, what):
    """Forward and reverse, by each parameter of each surface, against differences.

    Steps of 2 % and 1 % leave an error of 1e-3 where slopes are so small that single precision counts in the
    difference, and where PROSPECT bends as k log k at no absorption; a wrong factor in any term would be
    seen. The stem has no triangles here and shows in the scar's rim alone.
    """
    name = f"{surface}.{what}"
    if name not in renderer.parameters:
        assert name == "leaf.flesh_reflectance"
        return
    value = renderer.parameters[name]
    # Not the same for all knots, nor for both sides.
    direction = np.linspace(1.0, 0.5, value.size).reshape(value.shape)
    scale = max(np.abs(value).max(), SCALES.get(what, 1.0 if what.endswith("cm2") else 0.0))
    differences = slope_by_differences(renderer, name, direction, 0.02 * scale)
    forward = renderer.forward({}, {name: direction})
    strength = np.abs(differences).max()
    assert np.linalg.norm(forward - differences) <= 5e-3 * np.linalg.norm(differences)
    assert np.abs(forward - differences).max() <= 2e-2 * strength
    reverse = renderer.backward({name: value}, np.ones_like(forward))
    assert reverse.keys() == {name}
    assert (reverse[name] * direction).sum() == pytest.approx(
        differences.sum(), abs=5e-3 * np.abs(differences).sum()
    )


# --- against each other ---------------------------------------------------------------------------------


def test_reverse_is_the_transpose_of_forward(renderer):
    """g . (J d) = (J^T g) . d for each parameter: to 1e-5 of the terms' sizes, single precision's sums."""
    rng = np.random.default_rng(11)
    image_side = rng.normal(size=renderer.rgb().shape)
    reverse = renderer.backward(renderer.parameters, image_side)
    assert list(reverse) == list(renderer.parameters)
    everything = {}
    for name, value in renderer.parameters.items():
        everything[name] = direction = rng.normal(size=value.shape) * np.maximum(np.abs(value), 0.1)
        forward = renderer.forward({}, {name: direction})
        assert reverse[name].shape == value.shape
        terms = np.abs(forward * image_side).sum()
        assert (reverse[name] * direction).sum() == pytest.approx(
            (forward * image_side).sum(), abs=1e-5 * terms
        )
    forward = renderer.forward({}, everything)
    expected = sum((reverse[name] * direction).sum() for name, direction in everything.items())
    assert (forward * image_side).sum() == pytest.approx(
        expected, abs=1e-5 * np.abs(forward * image_side).sum()
    )


def test_gradients_add_up_over_passes(renderer, monkeypatch):
    """Passes of 40 pixels, the last of them shorter, find what a single one does."""
    image_side = np.random.default_rng(2).uniform(size=renderer.rgb().shape)
    name = "fruit.carotenoid_ug_cm2"
    whole = renderer.backward({name: renderer.parameters[name]}, image_side)[name]
    forward = renderer.forward({}, {name: 1.0})
    monkeypatch.setattr(passes, "_LANES", 40 * 16)
    assert renderer.backward({name: renderer.parameters[name]}, image_side)[name] == pytest.approx(
        whole, rel=1e-5
    )
    assert renderer.forward({}, {name: 1.0}) == pytest.approx(forward, rel=1e-6, abs=1e-6)


# --- stress ---------------------------------------------------------------------------------------------


WHITE = {f"leaf.{what}": 0.0 for what in (
    "chlorophyll_ug_cm2", "carotenoid_ug_cm2", "capsanthin_ug_cm2", "anthocyanin_ug_cm2", "brown", "water_cm",
    "dry_matter_g_cm2",
)}  # fmt: skip
BLACK = {"leaf.chlorophyll_ug_cm2": 1e4, "leaf.brown": 1e3, "leaf.dry_matter_g_cm2": 10.0}


@pytest.mark.parametrize(
    "values",
    [
        pytest.param(WHITE, id="R + T is 1"),
        pytest.param(WHITE | {"leaf.structure_n": 1.0}, id="one plate without pigments"),
        pytest.param(BLACK, id="R + T is 0"),
        pytest.param(BLACK | {"leaf.ior": 2.5, "leaf.roughness": 1.0}, id="all gloss"),
        pytest.param({"leaf.roughness": 1e-3, "fruit.roughness": 1e-3}, id="mirrors"),
        pytest.param({"leaf.roughness": 1.0, "fruit.roughness": 1.0}, id="rough"),
        pytest.param({"leaf.ior": 1.0, "fruit.ior": 1.0}, id="no gloss"),
        pytest.param({"fruit.flesh_reflectance": 0.0}, id="black flesh"),
        pytest.param({"flash.power": 1e-6}, id="a faint flash"),
    ],
)
def test_gradients_are_finite_at_the_ends(renderer, values):
    check_finite(renderer, values)


def check_finite(renderer, values=MappingProxyType({})):
    picture = renderer.rgb(values)
    assert np.isfinite(picture).all()
    assert picture.min() >= 0
    wanted = {**renderer.parameters, **values}
    reverse = renderer.backward(wanted, np.ones_like(picture))
    assert {name: np.isfinite(slope).all() for name, slope in reverse.items()} == dict.fromkeys(wanted, True)
    forward = renderer.forward(values, dict.fromkeys(renderer.parameters, 1.0))
    assert np.isfinite(forward).all()
    total = sum(slope.sum() for slope in reverse.values())
    assert forward.sum() == pytest.approx(total, abs=1e-4 * np.abs(forward).sum())


def test_gradients_without_light_are_nothing(surfaces, camera, kaite):
    dark = DifferentiableRenderer(bench(surfaces, None), replace(camera, flash=None), kaite, quality(4))
    assert "flash.power" not in dark.parameters
    assert (dark.rgb() == 0).all()
    assert (dark.forward({}, {"leaf.brown": 1.0, "exposure.gain": 1.0}) == 0).all()
    assert not any(slope.any() for slope in dark.backward(dark.parameters, np.ones((16, 24, 3))).values())


def test_gradients_under_the_sun_alone(surfaces, camera, kaite):
    sky = Sky(np.full((1, 2, 4), 1e-12, np.float32), Spectrum(NM, np.ones((1, NM.size))), SUN)
    check_finite(
        DifferentiableRenderer(bench(surfaces, sky), replace(camera, flash=None), kaite, quality(8, 1))
    )


def test_gradients_of_a_grey_camera(surfaces, camera, kaite):
    grey = replace(camera, sensor=replace(load_sensor("onsemi_mt9v024_mono"), columns=12, rows=8))
    renderer = DifferentiableRenderer(bench(surfaces), grey, kaite, quality(8, 1))
    assert renderer.rgb().shape == (8, 12, 1)
    check_finite(renderer)
    linear = renderer.forward({}, {"flash.power": 1.0, "exposure.gain": 0.0})
    twice = renderer.rgb({"flash.power": 2.0}) - renderer.rgb()
    assert linear == pytest.approx(twice, abs=1e-4 * twice.max())


# --- put to use -----------------------------------------------------------------------------------------


def test_descent_finds_a_leafs_chlorophyll(camera, kaite):
    """From half and from twice of it, out of a picture with other random numbers, to 2 %.

    The descent is plain: steps along the gradient of the squared error, as long as the last two gradients
    tell (Barzilai & Borwein 1988).
    """
    path = kaite.pigments["leaf"]
    leaf = leaf_surface("leaf", path, NM)
    mesh = concatenate_meshes(
        [card(0.0, 0.0, 0.06, 0.06, "leaf", z=0.44), card(0.0, 0.0, 1.0, 1.0, "matt", z=0.5)]
    )
    scene = assemble_scene(mesh, {"leaf": leaf, "matt": lambertian_surface("matt", 0.5)})
    small = replace(camera, sensor=replace(camera.sensor, columns=8, rows=8))
    target = DifferentiableRenderer(scene, small, kaite, quality(16, 1), seed=1).rgb()
    renderer = DifferentiableRenderer(scene, small, kaite, quality(16, 1), seed=2)
    name = "leaf.chlorophyll_ug_cm2"
    true = renderer.parameters[name]

    def error_slope(share):
        residual = (renderer.rgb({name: share * true}) - target) / target.mean()
        gradient = renderer.backward({name: share * true}, 2.0 * residual / target.mean())
        return float(gradient[name] @ true)

    for start in (0.5, 2.0):
        shares = [start, 0.9 * start + 0.1]
        slopes = [error_slope(shares[0])]
        for _ in range(10):
            slopes.append(error_slope(shares[-1]))
            curvature = (slopes[-1] - slopes[-2]) / (shares[-1] - shares[-2])
            step = np.clip(-slopes[-1] / abs(curvature), -0.3, 0.3)
            shares.append(float(shares[-1] + step))
            if abs(step) < 1e-4:
                break
        assert shares[-1] == pytest.approx(1.0, abs=0.02), (start, shares)


# --- what is refused ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "fault"),
    [
        ({"leaf.clorophyll": 1.0}, "there is no parameter 'leaf.clorophyll'"),
        ({"leaf.roughness": [0.1, 0.2, 0.3]}, "has the shape"),
        ({"leaf.roughness": 0.0}, "must lie in"),
        ({"leaf.structure_n": 0.9}, "must lie in"),
        ({"fruit.brown": float("nan")}, "must lie in"),
        ({"flash.power": 0.0}, "must be above 0"),
        ({"flash.spectrum": 0.0}, "must be above 0"),
        ({"exposure.f_number": float("inf")}, "be finite"),
    ],
)
def test_wrong_parameters_are_refused(renderer, values, fault):
    with pytest.raises(ValueError, match=fault):
        renderer.rgb(values)


def test_a_gradient_of_another_shape_is_refused(renderer):
    with pytest.raises(ValueError, match="16, 24, 3"):
        renderer.backward({"flash.power": 1.0}, np.ones((16, 24)))


def test_surfaces_of_another_cultivar_are_refused(surfaces, camera):
    with pytest.raises(ValueError, match="not what this cultivar's pigments make"):
        DifferentiableRenderer(bench(surfaces), camera, load_cultivar("red_blocky"), quality(4))
