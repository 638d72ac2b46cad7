"""Frames are reproducible to the byte, and nothing is computed that the outputs do not need."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from greenhouse import camera, digests, fresh_digests, greenhouse, partners
from processes import run_python

from pepperscene.camera import Partners, expected_electrons
from pepperscene.errors import InputError
from pepperscene.outputs import BAND_OUTPUTS, DEFAULT_OUTPUTS, METER_OUTPUTS, OUTPUTS
from pepperscene.render import (
    QUALITIES,
    Renderer,
    kernel_scene,
    photographs,
    render_scene,
    renderer,
)
from pepperscene.render.aov import labels
from pepperscene.render.reference.path_tracer import path_traced, samples_taken
from pepperscene.render.transport import strips
from pepperscene.scene import assemble_scene

# Harvest needs the plants' skeleton, and bands another sensor.
ALL = tuple(name for name in OUTPUTS if name != "harvest" and name not in BAND_OUTPUTS)
LABELS = tuple(name for name in ALL if not OUTPUTS[name].traced and name not in METER_OUTPUTS)
IMAGERS = ("imager_left", "imager_right")


@pytest.fixture(scope="module")
def scene():
    return greenhouse()


@pytest.fixture(scope="module")
def used(scene):
    """A renderer that has rendered another frame before."""
    result = Renderer(scene)
    result.render(camera(0), DEFAULT_OUTPUTS, "draft", 1)
    return result


@pytest.fixture(scope="module")
def frame(used):
    return used.render(camera(), ALL, "standard", 5, partners=partners())


def test_frame_has_the_same_bytes_in_another_process():
    # With another hash seed and, where the system allows it, a single core: neither the order of
    # sets nor the number of threads may matter.
    code = (
        "import json, os\n"
        "if hasattr(os, 'sched_setaffinity'):\n"
        "    os.sched_setaffinity(0, list(os.sched_getaffinity(0))[:1])\n"
        "from greenhouse import fresh_digests\n"
        "print(json.dumps(fresh_digests()))"
    )
    expected = fresh_digests()
    assert set(expected) == set(DEFAULT_OUTPUTS)
    assert run_python(code, PYTHONHASHSEED="2") == expected


@pytest.mark.long
def test_repeated_frames_are_equal_and_finite(scene, used, frame):
    # Lanes that have left the scene contain uninitialised memory; none of it may reach a pixel. Other renders
    # in between leave other values there.
    distinct = {digests(frame)["electrons"]}
    for i in range(4):
        used.render(camera(i % 3, distorted=i % 2 == 1), ["electrons"], ("draft", "standard")[i % 2], i)
        again = (used, Renderer(scene))[i % 2].render(camera(), ["electrons"], "standard", 5)
        assert np.isfinite(again["electrons"]).all(), i
        distinct.add(digests(again)["electrons"])
    assert len(distinct) == 1


def test_renderer_can_be_reused_for_another_pose_lens_or_image_size(scene, used, monkeypatch):
    moved = used.render(camera(2), ALL, "draft", 9, partners=partners(2))
    # Another version is recorded and changes no pixel.
    monkeypatch.setattr(renderer, "__version__", "9.9.9")
    monkeypatch.setattr(renderer, "_library_versions", renderer._library_versions.__wrapped__)
    fresh = Renderer(scene).render(camera(2), ALL, "draft", 9, partners=partners(2))
    assert digests(moved) == digests(fresh)
    assert fresh.metadata["versions"].pop("pepperscene") == "9.9.9"
    assert moved.metadata | {"versions": None} == fresh.metadata | {"versions": None}
    for other in (camera(distorted=True), camera(columns=40, rows=30)):
        again = used.render(other, DEFAULT_OUTPUTS, "draft", 3)
        fresh = render_scene(scene, other, DEFAULT_OUTPUTS, "draft", 3)
        assert digests(again) == digests(fresh)
        assert list(fresh.images) == list(DEFAULT_OUTPUTS)


def test_output_does_not_depend_on_the_other_outputs(scene, frame):
    another = Renderer(scene)
    traced = (["colour"], ["raw"], ["electrons"], ["colour_stereo"], list(IMAGERS))
    for names in (*traced, *([name] for name in (*LABELS, *METER_OUTPUTS))):
        alone = digests(another.render(camera(), names, "standard", 5, partners=partners()))
        assert alone == {name: digests(frame)[name] for name in names}


def test_another_seed_changes_noise_but_no_labels(used, frame):
    other = used.render(camera(), ALL, "standard", 6, partners=partners())
    same = {name: digests(other)[name] == digests(frame)[name] for name in ALL}
    assert same == {name: name in LABELS for name in ALL}
    # Before the sensor noise the two agree to a few per cent.
    difference = np.abs(other["electrons"] - frame["electrons"]).mean()
    assert 0.0 < difference < 0.05 * frame["electrons"].mean()
    assert np.abs(other["colour"].astype(int) - frame["colour"]).mean() < 8


def test_stereo_partner_has_its_own_noise_and_the_same_light(scene, frame):
    # From the camera's own pose it is another photograph of the same view.
    twin = Partners(stereo=camera())
    same = Renderer(scene).render(camera(), ["colour_stereo"], "standard", 5, partners=twin)
    difference = same["colour_stereo"].astype(float) - frame["colour"]
    assert 0.5 < np.abs(difference).mean() < 8
    assert abs(difference.mean()) < 0.5
    # Otherwise it is what a camera at the partner's pose takes.
    partner = partners().stereo
    own = Renderer(scene).render(partner, ["colour"], "standard", 77)
    error, baseline = (
        np.abs(own["colour"] - frame[name].astype(float)).mean() for name in ("colour_stereo", "colour")
    )
    assert error < 0.25 * baseline
    assert frame.metadata["stereo_pose"] == partner.pose.tolist()


def test_images_match_their_specification(frame):
    for name in ALL:
        image = frame[name]
        assert OUTPUTS[name].fits(image), name
        if not OUTPUTS[name].is_image:
            continue
        sizes = {"raw": camera().sensor.site_shape, **dict.fromkeys(IMAGERS, (60, 106))}
        assert image.shape[:2] == sizes.get(name, (60, 80)), name
    # Plants and the sky are in view.
    assert {0, 1, 2, 4} <= set(np.unique(frame["class"]).tolist())
    assert np.isfinite(frame["electrons"]).all()
    assert frame["electrons"].min() >= 0.0
    assert frame["colour"].std() > 5.0


def test_metadata_is_complete_and_plain_json(frame, scene):
    metadata = json.loads(json.dumps(dict(frame.metadata), allow_nan=False))
    assert metadata == frame.metadata
    assert metadata["camera"] == camera().to_metadata()
    assert metadata["seed"] == 5
    assert metadata["variant"].endswith("_ad_spectral")
    assert {"pepperscene", "mitsuba", "numpy", "python"} <= set(metadata["versions"])
    # It describes every instance with a pixel, and no other.
    values, counts = np.unique(frame["instance"][frame["instance"] > 0], return_counts=True)
    instances = metadata["instances"]
    pixels = {value: item["pixels"] for value, item in instances.items()}
    assert pixels == dict(zip(map(str, values.tolist()), counts.tolist(), strict=True))
    for value, item in instances.items():
        instance = scene.mesh.instances[int(value) - 1]
        assert (item["class"], item["kind"]) == (int(instance.organ_class), instance.kind)
        assert (item["plant"], item["phytomer"]) == (instance.plant, instance.phytomer)
        # Numbered like pixel values: 0 is none, and a parent precedes its child.
        assert item["parent"] == instance.parent + 1
        assert 0 <= item["parent"] < int(value)


@pytest.fixture
def calls(monkeypatch):
    """Names of the functions called, in order."""
    names = []

    def record(module, name):
        function = getattr(module, name)

        def recorded(*args, **kwargs):
            names.append(name)
            return function(*args, **kwargs)

        monkeypatch.setattr(module, name, recorded)

    for name in ("light_scene", "truth_scene", "sky_tables"):
        record(kernel_scene, name)
    for name in ("trace_rows", "denoised"):
        record(strips, name)
    record(photographs, "develop")
    for name in ("first_hits", "class_ids", "instance_ids", "normals", "depth_z"):
        record(labels, name)
    return names


def test_labels_trace_no_light(scene, calls):
    outputs = [name for name in LABELS if name != "albedo"]
    result = Renderer(scene).render(camera(), outputs, partners=partners())
    assert set(calls) == {"truth_scene", "first_hits", "class_ids", "instance_ids", "normals", "depth_z"}
    assert calls.count("first_hits") == 1
    assert set(result.images) == set(outputs)


@pytest.mark.parametrize(
    ("outputs", "expected"),
    [
        (["albedo"], ["first_hits", "instance_ids", "light_scene"]),
        (["chlorophyll", "leaf_age"], ["first_hits", "instance_ids", "truth_scene"]),
        (["distance"], ["first_hits", "instance_ids", "truth_scene"]),
        (["colour"], ["denoised", "develop", "light_scene", "sky_tables", "trace_rows"]),
        (["colour_stereo"], ["denoised", "develop", "light_scene", "sky_tables", "trace_rows"]),
    ],
)
def test_outputs_compute_only_what_they_need(scene, calls, outputs, expected):
    frame = Renderer(scene).render(camera(), outputs, "draft", partners=partners())
    assert sorted(calls) == expected
    if outputs == ["colour_stereo"]:
        assert set(frame.metadata) >= {"sampling_stereo", "stereo_pose"}
        assert "sampling" not in frame.metadata


@pytest.mark.parametrize(("quality", "denoised"), [("draft", True), ("reference", False)])
def test_electrons_are_not_developed_and_the_reference_is_not_denoised(scene, calls, quality, denoised):
    light = Renderer(scene).render(camera(columns=8, rows=6), ["electrons"], quality)
    assert "develop" not in calls
    assert ("denoised" in calls) == denoised
    assert light["electrons"].any()


@pytest.mark.long
def test_path_integrator_renders_with_the_path_tracer(scene):
    # Its scene is reused along a path, and rebuilt for a camera without flash.
    few = {"samples": 2, "soft": 2, "most": 2, "bounces": 1, "most_bounces": 0}
    quality = replace(QUALITIES["reference"], **few, integrator="path", sampler="stratified")
    path_renderer, seed = Renderer(scene), 9
    path_seed = int(np.random.SeedSequence(seed).spawn(2)[1].generate_state(1)[0])
    for view in (camera(columns=16, rows=12), camera(2, columns=16, rows=12), camera(flash=False)):
        frame = path_renderer.render(view, ["electrons"], quality, seed)
        signal = path_traced(scene, view, spp=2, bounces=1, sampler="stratified", seed=path_seed)
        assert (frame["electrons"] == expected_electrons(signal, view).astype(np.float32)).all()
        assert frame["electrons"].any()
        assert frame.metadata["sampling"] == {"samples_per_pixel": float(samples_taken("stratified", 2))}


def test_kernel_scene_is_built_once(scene, calls):
    reused = Renderer(scene)
    for step in range(3):
        reused.render(camera(step), DEFAULT_OUTPUTS, "draft")
    assert calls.count("light_scene") == 1
    assert calls.count("truth_scene") == 0
    assert calls.count("trace_rows") == 3


def test_modules_are_imported_only_when_needed():
    heavy = {"pyoidn", "colour", "OpenEXR", "PIL", "skimage", "pepperscene.dataset", "rich", "typer"}
    further = {f"pepperscene.render.aov.{name}" for name in ("coverage", "flow", "harvest")}
    on_import, with_labels, with_further = run_python(
        "import json, sys\n"
        "import pepperscene.render\n"
        "def imported(names): return sorted(names & set(sys.modules))\n"
        "result = [imported({'mitsuba', 'drjit', 'pyoidn', 'scipy'})]\n"
        "from pepperscene.render import Renderer\n"
        "from pepperscene.scene import assemble_scene\n"
        "from greenhouse import camera, row_of_plants\n"
        "renderer = Renderer(assemble_scene(row_of_plants()))\n"
        "renderer.render(camera(flash=False), ['class', 'distance', 'normal', 'position', 'uv'])\n"
        f"result.append(imported({heavy | further!r}))\n"
        "renderer.render(camera(flash=False), ['flow', 'coverage'])\n"
        f"print(json.dumps([*result, imported({further!r})]))"
    )
    assert on_import == []
    assert with_labels == []
    assert with_further == ["pepperscene.render.aov.coverage", "pepperscene.render.aov.flow"]


def test_raises_on_unknown_outputs_and_qualities_and_missing_partners(used):
    for outputs in (["depth"], ["colour", "Class"], []):
        with pytest.raises(InputError, match="colour, photo, raw, electrons, class"):
            used.render(camera(), outputs)
    for name in ("stereo", "colour_stereo"):
        with pytest.raises(InputError, match=f"partners: stereo: .*{name}"):
            used.render(camera(), [name], partners=Partners(flow=camera()))
    for output in ("colour", "class"):
        with pytest.raises(InputError, match=r"'best'.*draft, standard, reference"):
            used.render(camera(), [output], "best")


def test_raises_on_colour_without_surfaces(scene):
    bare = Renderer(assemble_scene(scene.mesh))
    with pytest.raises(ValueError, match="surfaces"):
        bare.render(camera(), ["colour"])
    # Labels do not need them.
    assert bare.render(camera(), ["class"])["class"].any()


def test_raises_on_more_instances_than_16_bits_can_count(scene):
    many = replace(scene.mesh, instances=scene.mesh.instances * 600)
    assert len(many.instances) > 65535
    with pytest.raises(ValueError, match="16-bit"):
        Renderer(assemble_scene(many)).render(camera(), ["instance"])
