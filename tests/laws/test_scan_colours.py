"""Colours of scans come back: fruit scanned in the colours of a chart look like it in even white light.

Cubes, each scanned in one colour, float under an even sky of D65 in front of a sensor with the responses of
the CIE 1931 observer. A matt skin sends out the colour itself; on a glossy one the gloss, which a black fruit
has alone, is taken off: L = E + (1 - E) R. Accepted: CIEDE2000 of 0.5 (median) and 2 (worst).
"""

from dataclasses import replace

import colour
import numpy as np
import pytest
import trimesh
from bodies import axis_camera
from colour_chart import D65, NM, OBSERVER, chart, difference, lab_of_rgb

from pepperscene.classes import OrganClass
from pepperscene.cultivar.organs import FruitScans, OrganKind
from pepperscene.geometry import mesh_plant, sphere
from pepperscene.grammar.plant import Organ, Plant
from pepperscene.materials import Surface
from pepperscene.render import Quality, Renderer
from pepperscene.scene import assemble_scene, uniform_sky
from pepperscene.spectra import Spectrum

COLUMNS, COUNT = 8, 28  # fruit in a row; of each skin
DIAMETER, PITCH, FAR = 0.04, 0.046, 0.5  # m, the last from the camera
WHITE, BLACK = 25, 26  # numbers of colours
RANGE_NM = np.array([300.0, 1100.0])
RED = np.tile([[[0.1, 0.9]]], (2, 2, 1)), np.zeros((2, 2))  # of pigments, which must not be seen
SKINS = {
    "matt": Surface("matt", RANGE_NM, *RED),
    "glossy": Surface("glossy", RANGE_NM, *RED, ior=1.45, roughness=(0.2, 0.2)),
}
QUALITY = Quality(samples=128, soft=128, most=128, bounces=3, target=None, denoise=False)


def observer():
    values = colour.MSDS_CMFS[OBSERVER].copy().align(colour.SpectralShape(380, 780, 1)).values
    return np.maximum(values, 0.0)


def d65():
    light = colour.SDS_ILLUMINANTS["D65"]
    return np.interp(NM, light.wavelengths, light.values)


def chart_codes():
    """`(28, 3)` 8-bit sRGB: 24 patches, then mid grey, white, black, and the reddest colour there is."""
    weight = d65()[:, None] * observer()
    xyz = chart() @ weight / weight[:, 1].sum()
    rgb = colour.XYZ_to_RGB(xyz, "sRGB", apply_cctf_encoding=True)
    further = [[128, 128, 128], [255, 255, 255], [0, 0, 0], [255, 0, 0]]
    return np.concatenate([np.round(255.0 * np.clip(rgb, 0.0, 1.0)), further]).astype(np.uint8)


def middles():
    """`(56, 3)` of all fruit, metres."""
    row, column = np.divmod(np.arange(2 * COUNT), COLUMNS)
    return np.stack([PITCH * (column - 3.5), PITCH * (row - 3.0), np.full(2 * COUNT, FAR)], axis=1)


def observer_camera():
    camera = axis_camera(96, 84, flash=False)
    per_photon = observer() / NM[:, None]
    efficiency = Spectrum(NM, per_photon.T / per_photon.max())
    return replace(camera, sensor=replace(camera.sensor, binning=8, quantum_efficiency=efficiency))


def scanned_fruit(folder):
    """All fruit, each scanned from a file of one colour."""
    organs, kinds, places = [], {}, middles()
    ends = 0.5 * DIAMETER * np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    size = {"length_m": DIAMETER, "diameter_m": DIAMETER, "seed": 0.3, "residue": 0.5}
    for number, code in enumerate(chart_codes()):
        cube = trimesh.creation.box().subdivide().subdivide().subdivide()
        cube.visual.vertex_colors = np.tile([*code, 255], (len(cube.vertices), 1)).astype(np.uint8)
        cube.export(path := folder / f"{number}.ply")
        for index, skin in enumerate(SKINS):
            kind = f"{skin} {number}"
            kinds[kind] = OrganKind("fruit", OrganClass.PEPPER, skin, FruitScans((path,), colour=True))
            place = places[number + index * COUNT]
            organs.append(Organ(kind, -1, number, place + ends, np.array([0.0, 0.0, -1.0]), size))
    return mesh_plant(Plant("chart", tuple(organs), kinds))


@pytest.fixture(scope="module")
def relative(tmp_path_factory):
    """`(2, 28, 3)` XYZ of matt and glossy fruit, over those of a perfect diffuser."""
    camera, sky = observer_camera(), uniform_sky(Spectrum(NM, d65()), 20_000.0)
    # The sky alone has the radiance of a perfect diffuser under it.
    behind = sphere([0.0, 0.0, -1.0], 0.01, "matt")
    fruit, white = (
        Renderer(assemble_scene(mesh, SKINS, sky)).render(camera, ["electrons"], QUALITY)["electrons"]
        for mesh in (scanned_fruit(tmp_path_factory.mktemp("chart")), behind)
    )
    lens, places = camera.to_metadata(), middles()
    x = np.floor(lens["fx"] * places[:, 0] / places[:, 2] + lens["cx"]).astype(int)
    y = np.floor(lens["fy"] * places[:, 1] / places[:, 2] + lens["cy"]).astype(int)
    around = np.arange(-1, 2)
    ratio = (fruit / white)[y[:, None, None] + around[:, None], x[:, None, None] + around]
    return ratio.mean(axis=(1, 2)).reshape(2, COUNT, 3)


def errors(relative):
    """`(28,)` CIEDE2000 of relative XYZ."""
    rgb = colour.XYZ_to_RGB(relative * colour.xy_to_XYZ(D65), "sRGB", apply_cctf_encoding=False)
    expected = colour.cctf_decoding(chart_codes() / 255.0, function="sRGB")
    return difference(lab_of_rgb(expected), lab_of_rgb(rgb))


def test_matt_fruit_have_the_colours_of_their_scans(relative):
    matt, _ = relative
    assert np.median(errors(matt)) < 0.5
    assert errors(matt).max() < 2.0
    # White fruit are as bright as the sky, and none is brighter.
    assert matt[WHITE] == pytest.approx(1.0, abs=0.01)
    assert matt.max() < 1.01


def test_glossy_fruit_have_their_gloss_in_addition(relative):
    _, glossy = relative
    gloss = glossy[BLACK]
    # Fresnel reflectance at the normal.
    assert gloss == pytest.approx((0.45 / 2.45) ** 2, rel=0.1)
    body = errors((glossy - gloss) / (1.0 - gloss))
    assert np.median(body) < 0.5
    assert body.max() < 2.0
    assert glossy.max() < 1.01
