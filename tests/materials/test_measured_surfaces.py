"""Surfaces of measured curves: the curve itself, how organs vary about it, and what is noted."""

from __future__ import annotations

import numpy as np
import pytest
from own_spectra import NM, leaf_curve, write_csv, write_leaf

from pepperscene.cultivar import load_cultivar
from pepperscene.errors import InputError
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import grow
from pepperscene.materials import curve_notes, organ_surfaces
from pepperscene.materials.gloss import cone_gloss

STEM = {"gloss": False, "reflectance": "stem"}


def cultivar(**spectra):
    return load_cultivar("kaite_clean", {"spectra": spectra})


def stem_file(folder, *samples):
    names = [f"stem_{number}" for number in range(len(samples))] if len(samples) > 1 else ["stem"]
    return write_csv(folder / "stem.csv", ",".join(["wavelength_nm", *names]), NM, *samples), names


def test_matt_surfaces_have_the_curve(tmp_path):
    reflectance, transmittance = leaf_curve(NM)
    file, _ = stem_file(tmp_path, reflectance)
    own = cultivar(leaf={"file": str(write_leaf(tmp_path)), "gloss": False}, stem={"file": str(file), **STEM})
    surfaces = organ_surfaces(own, NM)
    for name, through in (("leaf", transmittance), ("stem", np.zeros(NM.size))):
        surface = surfaces[name]
        assert surface.ior == 1.0
        assert surface.relief_mm is not None
        for row in range(len(surface.states)):
            np.testing.assert_allclose(surface.reflectance[row], np.tile(reflectance, (2, 1)), rtol=1e-6)
            np.testing.assert_allclose(surface.transmittance[row], through, rtol=1e-6)
    # Other surfaces are those of their pigments.
    plain = organ_surfaces(load_cultivar("kaite_clean"), NM)
    np.testing.assert_array_equal(surfaces["fruit"].reflectance, plain["fruit"].reflectance)


def test_cuticle_and_body_together_have_the_curve(tmp_path):
    own = cultivar(leaf={"file": str(write_leaf(tmp_path))})
    leaf, path = organ_surfaces(own, NM)["leaf"], own.pigments["leaf"]
    reflectance, transmittance = leaf_curve(NM)
    lobes = ((1.0 - path.wide_share, path.roughness[0]), (path.wide_share, path.wide_roughness[0]))
    gloss = sum(share * cone_gloss(path.ior, alpha) for share, alpha in lobes)
    middle = len(leaf.states) // 2
    absorbed = 1.0 - leaf.reflectance[middle, 0] - leaf.transmittance[middle]
    # What does not enter is reflected; what enters is absorbed by the body, or leaves on one of both sides.
    np.testing.assert_allclose((1.0 - gloss) * absorbed, 1.0 - reflectance - transmittance, atol=0.005)


def test_factor_between_organs(tmp_path):
    own = cultivar(leaf={"file": str(write_leaf(tmp_path)), "gloss": False, "spread": 0.03})
    leaf = organ_surfaces(own, NM)["leaf"]
    reflectance, transmittance = leaf_curve(NM)
    deviations = 6.0 * (leaf.states - 0.5)
    np.testing.assert_allclose(
        leaf.reflectance[:, 0], np.outer(1.0 - 0.03 * deviations, reflectance), rtol=1e-6
    )
    np.testing.assert_allclose(leaf.transmittance, np.outer(1 - 0.03 * deviations, transmittance), rtol=1e-6)
    # The texture of veins varies as organs do, and leaves the mean of a leaf as it is.
    assert abs(leaf.pattern.mean(dtype=float)) < 1e-6


def test_organs_far_from_the_mean_scatter_no_more_light_than_there_is(tmp_path):
    leaf = organ_surfaces(cultivar(leaf={"file": str(write_leaf(tmp_path)), "spread": 0.2}), NM)["leaf"]
    assert (leaf.reflectance + leaf.transmittance[:, None]).max() <= 1.0
    assert (leaf.reflectance >= 0.0).all()


def test_samples_vary_along_their_principal_component(tmp_path):
    rng = np.random.default_rng(5)
    reflectance, _ = leaf_curve(NM)
    mode = 0.03 * np.exp(-(((NM - 560.0) / 60.0) ** 2))
    samples = reflectance + rng.standard_normal((12, 1)) * mode + 1e-5 * rng.standard_normal((12, NM.size))
    file, names = stem_file(tmp_path, *samples)
    stem = organ_surfaces(cultivar(stem={"file": str(file), **STEM, "reflectance": names}), NM)["stem"]
    rows = stem.reflectance[:, 0]
    np.testing.assert_allclose(rows[6], samples.mean(axis=0), atol=1e-8)
    # The covariance of organs is that of the samples, by its largest eigenvalue.
    values, vectors = np.linalg.eigh(np.cov(samples.T))
    expected = np.sqrt(values[-1]) * np.abs(vectors[:, -1])
    np.testing.assert_allclose(np.abs(rows[8] - rows[6]), expected, atol=1e-7)
    # Towards state 1, organs are darker.
    assert rows[12].mean() < rows[0].mean()


def test_organs_are_drawn_about_the_curve_and_a_stem_is_one(tmp_path):
    file, _ = stem_file(tmp_path, leaf_curve(NM)[0])
    spectra = {
        "leaf": {"file": str(write_leaf(tmp_path)), "spread": 0.1},
        "stem": {"file": str(file), **STEM},
    }
    meshes = {}
    for name, own in (("own", cultivar(**spectra)), ("pigments", load_cultivar("kaite_clean"))):
        plants = [grow(own, np.random.default_rng(seed)) for seed in range(4)]
        meshes[name] = [mesh_plant(plant, 0.3) for plant in plants]
    states = []
    for mesh, other in zip(meshes["own"], meshes["pigments"], strict=True):
        np.testing.assert_array_equal(mesh.vertices, other.vertices)
        surface = np.array(mesh.surfaces)[mesh.face_surface]
        on = {name: np.unique(mesh.faces[surface == name]) for name in mesh.surfaces}
        stems = np.unique(mesh.state[on["stem"]])
        assert stems.size == 1
        np.testing.assert_array_equal(mesh.state[on["fruit"]], other.state[on["fruit"]])
        for instance in np.unique(mesh.face_instance[surface == "leaf"]):
            own_states = np.unique(mesh.state[mesh.faces[mesh.face_instance == instance]])
            assert own_states.size == 1
            states.append(float(own_states[0]))
    deviations = 6.0 * (np.array(states) - 0.5)
    count = deviations.size
    assert count > 100
    assert abs(deviations.mean()) < 4.0 / np.sqrt(count)
    assert abs(deviations.std() - 1.0) < 4.0 / np.sqrt(2 * count)


def test_notes_say_range_extension_and_dark_bands(tmp_path):
    own = cultivar(leaf={"file": str(write_leaf(tmp_path))})
    assert curve_notes(own, 450.0, 950.0) == ("leaf: leaf.csv is measured from 400 to 1000 nm",)
    (note,) = curve_notes(own, 380.0, 950.0)
    assert note.endswith("; the cameras see 380 to 950 nm, and its end values hold outside")
    dark = write_csv(
        tmp_path / "dark.csv", "wavelength_nm,reflectance,transmittance", NM, 0.0 * NM + 0.001, 0.1 + 0.0 * NM
    )
    _, note = curve_notes(cultivar(leaf={"file": str(dark)}), 450.0, 950.0)
    assert "below 0.0" in note
    assert "between 450 and 950 nm" in note
    assert len(curve_notes(cultivar(leaf={"file": str(dark), "gloss": False}), 450.0, 950.0)) == 1


@pytest.mark.parametrize(
    ("surface", "table", "message"),
    [
        ("root", {}, r"spectra\.root: must be one of the pigments: leaf"),
        ("fruit", {"transmittance": "t"}, r"spectra\.fruit\.transmittance: must be left out: only blades"),
        (
            "leaf",
            {"reflectance": ["a", "b"], "transmittance": ["a", "b"], "spread": 0.1},
            "spread must be left out",
        ),
        (
            "leaf",
            {"reflectance": ["a", "b"], "transmittance": "t"},
            "transmittance must have as many columns",
        ),
        ("leaf", {"spread": 0.5}, r"spectra\.leaf\.spread = 0\.5: must be less than or equal to 0\.3"),
    ],
)
def test_tables_that_do_not_fit_are_refused(tmp_path, surface, table, message):
    with pytest.raises(InputError, match=message):
        cultivar(**{surface: {"file": str(write_leaf(tmp_path)), **table}})


def test_files_are_relative_to_the_cultivar_that_names_them(tmp_path):
    (tmp_path / "curves").mkdir()
    file = write_leaf(tmp_path / "curves")
    (tmp_path / "own.toml").write_text(
        'extends = "kaite"\nname = "own"\n[spectra.leaf]\nfile = "curves/leaf.csv"\n', encoding="utf-8"
    )
    child = 'extends = "own.toml"\nname = "child"\n[spectra.leaf]\nspread = 0.05\n'
    (tmp_path / "child.toml").write_text(child.replace("own.toml", "../own.toml"), encoding="utf-8")
    (tmp_path / "curves" / "child.toml").write_text(
        'extends = "../own.toml"\nname = "child"\n[spectra.leaf]\nfile = "leaf.csv"\nspread = 0.05\n'
    )
    assert load_cultivar(tmp_path / "own.toml").spectra["leaf"].file == file
    assert load_cultivar(tmp_path / "curves" / "child.toml").spectra["leaf"].spread == 0.05
