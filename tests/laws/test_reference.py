"""Our integrator against Mitsuba's path tracer, for all kinds of lights.

Both use the same meshes, materials, camera rays and response. Light transport is implemented twice: ours in
`pepperscene.render.transport.trace`, the reference in Mitsuba, with the emitters of
`pepperscene.render.reference.emitters` or with Mitsuba's own.
"""

from dataclasses import replace

import numpy as np
import pytest
from bodies import axis_camera, card, sheet, sphere
from scipy import stats

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import AngularProfile, Camera, expected_electrons, load_sensor
from pepperscene.classes import Appearance
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import Surface, lambertian_surface
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.render import QUALITIES, Renderer
from pepperscene.render.reference.emitters import daylight_emitter
from pepperscene.render.reference.path_tracer import SAMPLERS, path_scene, path_traced
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene, Sky, Sun, assemble_scene, uniform_sky
from pepperscene.spectra import Spectrum

NM = np.arange(360.0, 831.0, 5.0)  # wider than the sensor's range
BLOCK = 4
"""Pixels; statistics are computed over square blocks, whose means are nearly normal."""

OUR_FRAMES, REFERENCE_FRAMES = 3, 10
"""The reference has most of the noise."""

TOLERANCE = 2e-4
"""Relative to a block's light: the error of a 1 nm grid at kinks of the spectra."""

BOUNCES = QUALITIES["reference"].bounces


# --- scenes -------------------------------------------------------------------------------------------------


def thin_leaf() -> Surface:
    """Transmits most of what it does not absorb, under cuticles of different gloss."""
    red_edge = 0.05 + 0.4 / (1.0 + np.exp(-(NM - 600.0) / 15.0))
    both = np.stack([red_edge, 1.1 * red_edge])[None].repeat(3, axis=0)
    return Surface("leaf", NM, both, 0.8 * red_edge[None].repeat(3, axis=0), 1.45, (0.25, 0.4))


def glossy_fruit() -> Surface:
    """An opaque, glossy yellow body."""
    yellow = 0.05 + 0.65 / (1.0 + np.exp(-(NM - 510.0) / 12.0))
    both = np.broadcast_to(yellow, (1, 2, NM.size)).copy()
    return Surface("fruit", NM, both, np.zeros((1, NM.size)), 1.5, (0.12, 0.12))


def still_life(sky: Sky | None = None, card_m: float = 2.0) -> Scene:
    """A thin leaf that shades a glossy fruit, both in front of a matt card; the camera looks along +z."""
    fruit, leaf = sphere((0.03, 0.02, 0.45), 0.06, "fruit", 3), card(-0.12, 0.0, 0.15, 0.4, "leaf", 0.4)
    mesh = concatenate_meshes([fruit, leaf, sheet(card_m, card_m, 0.6, "card")])
    surfaces = {"card": lambertian_surface("card", 0.6), "leaf": thin_leaf(), "fruit": glossy_fruit()}
    return assemble_scene(mesh, surfaces, sky)


def camera(*, flash: bool = True, **flash_changes: object) -> Camera:
    """The recipe's camera a metre from the still life, with few large pixels."""
    pose = np.eye(4)
    pose[2, 3] = -0.4
    return few_pixels(axis_camera(flash=flash, **flash_changes).at_pose(pose))


def few_pixels(original: Camera, columns: int = 32) -> Camera:
    """The same field of view in fewer, larger pixels, without stray light, which the path tracer lacks."""
    sensor, factor = original.sensor, original.sensor.columns // columns
    rows = sensor.rows // factor // BLOCK * BLOCK
    sensor = replace(sensor, columns=columns, rows=rows, binning=sensor.binning * factor)
    developing = replace(original.developing, stray_light=False)
    return replace(original, sensor=sensor, developing=developing)


def patchy_sky(sun: Sun | None = None) -> Sky:
    """Two spectra with strong, different patterns over the whole sphere."""
    weights = np.random.default_rng(3).uniform(0.0, 1.0, (2, 6, 12)).astype(np.float32) ** 3
    slopes = np.stack([1.0 + 0.002 * (NM - 580.0), 1.0 - 0.002 * (NM - 580.0)])
    return Sky(weights, Spectrum(NM, slopes), sun)


def sun(direction: tuple[float, float, float], radius: float, irradiance: float = 5.0) -> Sun:
    unit = np.array(direction) / np.linalg.norm(direction)
    return Sun(unit, Spectrum(NM, irradiance * (1.0 + 0.001 * (NM - 580.0))), radius)


def point_flash() -> dict[str, object]:
    """Next to the lens, so that shadows are visible, with a beam that ends inside the image."""
    beam = AngularProfile(np.radians([0.0, 5.0, 12.0, 18.0]), np.array([1.0, 0.9, 0.4, 0.0]))
    position = {"emitters_m": np.zeros((1, 2)), "offset_m": (0.05, -0.02, 0.01)}
    return {"radius_m": 0.0, "profile": beam, **position}


def few_discs() -> dict[str, object]:
    """Three wide discs at different distances, each with the whole profile."""
    beam = AngularProfile(np.radians([0.0, 10.0, 30.0]), np.array([1.0, 1.2, 0.1]))
    positions = np.array([[0.1, 0.0], [-0.06, 0.05], [0.0, -0.15]])
    return {"radius_m": 0.03, "emitters_m": positions, "profile": beam}


def mono() -> Camera:
    return few_pixels(replace(camera(), sensor=load_sensor("onsemi_mt9v024_mono")))


def weathered_life(sky: Sky | None = None) -> Scene:
    """The still life with a bumpy leaf under two lobes of gloss, partly covered with residue and half dry.

    Its relief, of bumps of a few millimetres, is filtered: a pixel covers one to two centimetres.
    """
    rng = np.random.default_rng(4)
    x = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    relief = np.stack([np.sin(k * x)[:, None] * np.sin(k * x)[None] for k in (12, 20)]) * 0.2
    leaf = thin_leaf()
    dry = np.stack([leaf.reflectance[0] * (0.5 + 0.25 * k) for k in range(3)])
    through = np.stack([leaf.transmittance[0] * (0.4 * k) for k in range(3)])
    leaf = replace(
        leaf, reflectance=dry, transmittance=through, first_state=-1.0,
        wide_roughness=(0.7, 0.9), wide_share=0.4, relief_mm=relief.astype(np.float32),
        pattern=0.3 * rng.uniform(-1.0, 1.0, (2, 64, 64)).astype(np.float32),
        residue_pattern=rng.uniform(0.0, 2.0, (2, 64, 64)).astype(np.float32),
        ageing_order=rng.uniform(0.0, 1.0, (2, 64, 64)).astype(np.float32),
    )  # fmt: skip
    scene = still_life(sky, 0.5)
    mesh, number = scene.mesh, scene.mesh.surfaces.index("leaf")
    on_leaf = np.unique(mesh.faces[mesh.face_surface == number])
    uv = mesh.uv.copy()
    uv[on_leaf] = (mesh.vertices[on_leaf, :2] - (-0.195, -0.2)) / (0.15, 0.4)
    appearance = np.where(mesh.face_surface == number, np.uint32(1), np.uint32(0))
    appearances = (Appearance(), Appearance(residue=0.3, ageing=0.5, variant=3))
    surfaces = tuple(leaf if surface.name == "leaf" else surface for surface in scene.surfaces)
    mesh = replace(mesh, uv=uv, face_appearance=appearance, appearances=appearances)
    return replace(scene, mesh=mesh, surfaces=surfaces)


BACK, FRONT = (0.4, -0.5, -1.0), (0.12, -0.05, 1.0)  # behind the camera, and in view

SCENES = {
    "flash of many emitters": lambda: (still_life(), camera()),
    "point flash with a narrow beam": lambda: (still_life(), camera(**point_flash())),
    "flash of a few wide discs": lambda: (still_life(), camera(**few_discs())),
    "uniform sky": lambda: (
        still_life(uniform_sky(Spectrum(NM, np.ones(NM.size)), 5e4), 0.5),
        camera(flash=False),
    ),
    "patchy sky": lambda: (still_life(patchy_sky(), 0.5), camera(flash=False)),
    "wide sun": lambda: (still_life(patchy_sky(sun(BACK, 0.2))), camera(flash=False)),
    "wide sun in view, through the leaf": lambda: (
        still_life(patchy_sky(sun(FRONT, 0.15)), 0.3),
        camera(flash=False),
    ),
    "real sun, flash and sky": lambda: (still_life(patchy_sky(sun(BACK, 0.004654))), camera()),
    "mono sensor": lambda: (still_life(patchy_sky(), 0.5), mono()),
    "flash on a weathered leaf": lambda: (weathered_life(), camera()),
    "weathered leaf by daylight": lambda: (
        weathered_life(patchy_sky(sun(BACK, 0.2))),
        replace(camera(flash=False), lens=replace(camera().lens, f_number=0.8), focus_m=0.4),
    ),
    "out of focus": lambda: (
        still_life(patchy_sky(), 0.5),
        replace(camera(), lens=replace(camera().lens, f_number=0.8), focus_m=0.4),
    ),
}


# --- both integrators, and statistics -----------------------------------------------------------------------


def ours(scene: Scene, camera: Camera) -> np.ndarray:
    """`(n, h, w, c)` electrons by our integrator, with one seed each."""
    renderer = Renderer(scene)
    return np.stack(
        [renderer.render(camera, ["electrons"], "reference", seed)["electrons"] for seed in range(OUR_FRAMES)]
    )


def reference(
    scene: Scene, camera: Camera, spp: int = 144, frames: int = REFERENCE_FRAMES, **options: object
) -> np.ndarray:
    """`(n, h, w, c)` electrons by Mitsuba's path tracer, with one seed each."""
    options = {"bounces": BOUNCES, "kernel_scene": path_scene(scene, camera), **options}
    signals = [path_traced(scene, camera, spp=spp, seed=100 + n, **options) for n in range(frames)]
    return np.stack([expected_electrons(signal, camera) for signal in signals])


def block_means(frames: np.ndarray) -> np.ndarray:
    """`(n, blocks * c + c)` means over blocks and over the whole image."""
    n, h, w, c = frames.shape
    blocks = frames.astype(float).reshape(n, h // BLOCK, BLOCK, w // BLOCK, BLOCK, c).mean((2, 4))
    return np.concatenate([blocks.reshape(n, -1), blocks.mean((1, 2))], axis=1)


def assert_agree(first: np.ndarray, second: np.ndarray, precision: float = 0.005) -> None:
    """Welch's tests (1947) over blocks and channels, with Bonferroni's correction of the smallest p-value.

    `precision` limits the relative standard error of the image's mean: otherwise the test has no power.
    """
    assert np.isfinite(first).all()
    assert np.isfinite(second).all()
    a, b = block_means(first), block_means(second)
    squares = a.var(axis=0, ddof=1) / len(a), b.var(axis=0, ddof=1) / len(b)
    error = np.sqrt(squares[0] + squares[1])
    channels = first.shape[-1]
    assert (error[-channels:] < precision * b[:, -channels:].mean(axis=0)).all(), "too noisy"

    # The tolerance covers wavelength grids and single precision where light has no noise.
    difference = np.abs(a.mean(axis=0) - b.mean(axis=0)) - TOLERANCE * b.mean(axis=0)
    tiny = 1e-9 * b.mean()
    freedom = error**4 / (squares[0] ** 2 / (len(a) - 1) + squares[1] ** 2 / (len(b) - 1) + tiny**4)
    p = 2.0 * stats.t.sf(np.maximum(difference, 0.0) / (error + tiny), np.maximum(freedom, 1.0))
    worst = int(p.argmin())
    details = a.mean(axis=0)[worst], b.mean(axis=0)[worst], error[worst], freedom[worst]
    ratio = a[:, -channels:].mean(axis=0) / b[:, -channels:].mean(axis=0)
    assert p[worst] * p.size > 1e-3, (p[worst], p.size, details, ratio)


# --- our integrator -----------------------------------------------------------------------------------------


IN_CI = {"real sun, flash and sky", "weathered leaf by daylight"}
CASES = [kind if kind in IN_CI else pytest.param(kind, marks=pytest.mark.long) for kind in SCENES]


@pytest.mark.parametrize("kind", CASES)
def test_light_equals_the_reference(kind):
    scene, camera = SCENES[kind]()
    assert_agree(ours(scene, camera), reference(scene, camera))


FEW = {"row.plants_front": 1, "row.plants_back": 1}


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "index", "columns", "changes"),
    [
        ("demo", 110, 40, {**FEW, "daylight.sun_azimuth_deg": -60}),
        ("greenhouse", 1, 40, {**FEW, "greenhouse.far_rows": 0}),
        ("demo", 2290, 100, {}),
        ("barth2018", 125, 100, {}),
        ("greenhouse", 4, 100, {}),
    ],
)
def test_light_on_plants_equals_the_reference(name, index, columns, changes):
    recipe = load_recipe(name, changes)
    frames, spec = FrameRenderer(recipe), recipe.plan.frame(index)
    scene, camera = frames.scene(spec), few_pixels(frames.camera(spec), columns)
    # By daylight paths go on until Russian roulette ends them.
    bounces = BOUNCES if camera.flash is not None else QUALITIES["reference"].most_bounces
    assert_agree(ours(scene, camera), reference(scene, camera, bounces=bounces))


# --- Mitsuba's own emitters ---------------------------------------------------------------------------------


def mitsuba_spectrum(values: np.ndarray) -> dict[str, str]:
    texts = (", ".join(f"{value:.9g}" for value in row) for row in (NM, values))
    return {"type": "irregular", **dict(zip(("wavelengths", "values"), texts, strict=True))}


def spot_camera() -> tuple[Camera, dict[str, object]]:
    """A camera with a point flash of linear falloff next to it, and that flash as Mitsuba's spot emitter."""
    profile = AngularProfile(np.radians([0.0, 15.0, 30.0]), np.array([1.0, 1.0, 0.0]))
    offset = np.array([0.01, -0.02, 0.0])
    view = camera(radius_m=0.0, emitters_m=np.zeros((1, 2)), offset_m=tuple(offset), profile=profile)
    mi, _ = mitsuba_modules()
    origin = view.pose[:3, 3] + offset
    spot = {
        "type": "spot",
        "to_world": mi.ScalarTransform4f().look_at(
            origin.tolist(), (origin + np.array([0.0, 0.0, 1.0])).tolist(), [0, 1, 0]
        ),
        "beam_width": 15.0,
        "cutoff_angle": 30.0,
        "intensity": mitsuba_spectrum(view.flash.radiant_intensity(NM) * view.flash_duty),
    }
    return view, spot


def sun_alone(irradiance: float) -> tuple[Sky, dict[str, object]]:
    """A sun without a sky, and Mitsuba's directional emitter."""
    disc = sun(BACK, 1e-4, irradiance)
    sky = Sky(np.full((1, 2, 4), 1e-9, np.float32), Spectrum(NM, np.ones((1, NM.size))), disc)
    directional = {
        "type": "directional",
        "direction": (-disc.direction).tolist(),
        "irradiance": mitsuba_spectrum(disc.irradiance.values),
    }
    return sky, directional


def reference_with(emitters: dict[str, dict[str, object]], scene: Scene, camera: Camera) -> np.ndarray:
    """`reference` with Mitsuba's emitters instead of ours."""
    scene, camera = replace(scene, sky=None), replace(camera, flash=None)
    unlit = path_scene(scene, camera)
    parts = {"type": "scene", "plants": unlit.scene.shapes()[0], **emitters}
    lit = replace(unlit, scene=mitsuba_modules()[0].load_dict(parts))
    return reference(scene, camera, kernel_scene=lit)


@pytest.mark.long
def test_flash_and_sky_equal_mitsubas_emitters():
    view, spot = spot_camera()
    scene = still_life(uniform_sky(Spectrum(NM, 1.0 + 0.001 * (NM - 550.0)), 60_000.0))
    constant = {"type": "constant", "radiance": mitsuba_spectrum(scene.sky.radiance.values[0])}
    assert_agree(ours(scene, view), reference_with({"flash": spot, "sky": constant}, scene, view))


@pytest.mark.parametrize(
    "irradiance", [1.0, *(pytest.param(one, marks=pytest.mark.long) for one in (0.03, 2.0))]
)
def test_flash_and_sun_equal_mitsubas_emitters(irradiance):
    # A weak sun at first hits is indirect light. The last case has no flash.
    sky, directional = sun_alone(irradiance)
    scene = still_life(sky)
    if irradiance == 2.0:
        view, emitters = camera(flash=False), {"sun": directional}
    else:
        view, spot = spot_camera()
        emitters = {"flash": spot, "sun": directional}
    assert_agree(ours(scene, view), reference_with(emitters, scene, view))


# --- the reference itself -----------------------------------------------------------------------------------


@pytest.mark.parametrize("sampler", SAMPLERS[1:])
@pytest.mark.long
def test_samplers_agree(sampler):
    scene, lit = still_life(patchy_sky(sun(BACK, 0.2))), camera()
    assert_agree(reference(scene, lit, spp=64, bounces=1, sampler=sampler), reference(scene, lit, bounces=1))


def test_same_seed_gives_the_same_bits():
    scene, lit = still_life(patchy_sky(sun(BACK, 0.2))), camera()
    options = {"spp": 16, "bounces": 2, "kernel_scene": path_scene(scene, lit)}
    first, again = (path_traced(scene, lit, seed=5, **options) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first, path_traced(scene, lit, spp=16, bounces=2, seed=5))
    assert (first != path_traced(scene, lit, seed=6, **options)).mean() > 0.9


def test_flash_of_a_reused_scene_follows_the_camera():
    scene, first = still_life(), camera()
    pose = np.array(first.pose)
    pose[:3, 3] += (0.02, 0.01, 0.1)
    second = first.at_pose(pose)
    kernel_scene = path_scene(scene, first)
    result = path_traced(scene, second, spp=16, bounces=1, kernel_scene=kernel_scene)
    np.testing.assert_array_equal(result, path_traced(scene, second, spp=16, bounces=1))
    other = path_traced(scene, first, spp=16, bounces=1, kernel_scene=kernel_scene)
    assert not np.array_equal(result, other)


@pytest.mark.parametrize("radius", [0.004654, 1.2, None])
def test_light_samples_of_the_daylight_follow_their_density(radius):
    # The density integrates to 1 over solid angle. Samples cover the sun's disc, or the sphere without a sun.
    mi, dr = mitsuba_modules()
    grid = np.arange(400.0, 701.0)
    sky = patchy_sky(None if radius is None else sun((0.3, -0.2, 0.8), radius))
    emitter = daylight_emitter().of(sky, grid, 1.0, 10.0)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, 1 << 18)
    it = dr.zeros(mi.SurfaceInteraction3f, 1 << 18)
    it.wavelengths = mi.Spectrum(550.0)
    sample, weight = emitter.sample_direction(it, sampler.next_2d())
    it.wi = -sample.d
    radiance = np.asarray(emitter.eval(it))[0]
    density = np.broadcast_to(np.asarray(emitter.pdf_direction(it, sample)), radiance.shape)
    inside = density > 0.0
    assert inside.mean() > 0.999  # the rest is rounded over the rim
    np.testing.assert_allclose(np.broadcast_to(sample.pdf, density.shape), density, rtol=1e-5)
    np.testing.assert_allclose((np.asarray(weight)[0] * density)[inside], radiance[inside], rtol=1e-4)
    # Importance sampling of the constant 1 gives the solid angle that is sampled.
    solid_angle = 4.0 * np.pi if radius is None else 2.0 * np.pi * (1.0 - np.cos(radius))
    values = np.where(inside, 1.0 / np.maximum(density, 1e-20), 0.0)
    error = values.std() / np.sqrt(values.size) + 1e-3 * solid_angle
    assert values.mean() == pytest.approx(solid_angle, abs=4.0 * error)
