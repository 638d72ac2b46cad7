"""Frames are the same bytes for the same question, and answer no question that was not asked."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from greenhouse import built_from_nothing, camera, digests, greenhouse, others

from pepperscene.camera import expected_electrons
from pepperscene.errors import InputError
from pepperscene.frame import DEFAULT_OUTPUTS, OUTPUTS
from pepperscene.render import QUALITIES, Renderer, find_quality, render_scene, renderer
from pepperscene.render.aov import labels
from pepperscene.render.reference.path_tracer import path_traced, samples_taken
from pepperscene.scene import assemble_scene

ALL = tuple(name for name in OUTPUTS if name != "harvest")  # which needs plants whose organs are known
LABELS = tuple(name for name in ALL if not OUTPUTS[name].traced)


@pytest.fixture(scope="module")
def scene():
    return greenhouse()


@pytest.fixture(scope="module")
def used(scene):
    """A renderer that has rendered other things before."""
    made = Renderer(scene)
    made.render(camera(0), DEFAULT_OUTPUTS, "draft", 1)
    return made


@pytest.fixture(scope="module")
def frame(used):
    return used.render(camera(), ALL, "standard", 5, others=others())


# --- same question, same bytes ----------------------------------------------------------------------------


def in_a_process(code, **environment):
    """What a fresh interpreter that can import this folder's modules prints last, as JSON."""
    here = os.pathsep.join([str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": here, **environment},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_a_frame_is_the_same_bytes_in_any_process():
    # The second process has another hash seed and, where the system can say so, a single core: neither the
    # order of sets nor the number of threads may show.
    tell = "import json; from greenhouse import built_from_nothing; print(json.dumps(built_from_nothing()))"
    alone = (
        "import os\n"
        "if hasattr(os, 'sched_setaffinity'): os.sched_setaffinity(0, list(os.sched_getaffinity(0))[:1])\n"
    )
    here = built_from_nothing()
    assert set(here) == set(DEFAULT_OUTPUTS)
    assert in_a_process(tell, PYTHONHASHSEED="1") == here
    assert in_a_process(alone + tell, PYTHONHASHSEED="2") == here


def test_a_frame_is_the_same_bytes_twice_in_one_process(scene, frame):
    assert digests(Renderer(scene).render(camera(), ALL, "standard", 5, others=others())) == digests(frame)


def test_frame_after_frame_is_the_same_and_a_number(scene, used):
    # Lanes that have left the scene hold whatever was in memory; none of it may reach a pixel. Renders of
    # another kind in between leave other things there.
    seen = set()
    for turn in range(16):
        used.render(
            camera(turn % 3, distorted=turn % 2 == 1), ["electrons"], ("draft", "standard")[turn % 2], turn
        )
        again = (used, Renderer(scene))[turn % 2].render(camera(), ["electrons"], "standard", 5)
        assert np.isfinite(again["electrons"]).all(), turn
        seen.add(digests(again)["electrons"])
    assert len(seen) == 1


@pytest.mark.parametrize("step", [0, 2])
def test_a_moved_camera_needs_no_new_renderer(scene, used, step):
    moved = used.render(camera(step), ALL, "draft", 9, others=others(step))
    fresh = Renderer(scene).render(camera(step), ALL, "draft", 9, others=others(step))
    assert digests(moved) == digests(fresh)
    assert moved.facts == fresh.metadata


def test_other_lenses_and_sizes_need_no_new_renderer(scene, used):
    for other in (camera(distorted=True), camera(columns=40, rows=30), camera()):
        again = used.render(other, DEFAULT_OUTPUTS, "draft", 3)
        assert digests(again) == digests(Renderer(scene).render(other, DEFAULT_OUTPUTS, "draft", 3))


@pytest.mark.parametrize("name", ALL)
def test_an_output_does_not_depend_on_what_else_is_asked_for(scene, frame, name):
    alone = Renderer(scene).render(camera(), [name], "standard", 5, others=others())
    assert set(alone.images) == {name}
    assert digests(alone)[name] == digests(frame)[name]


def test_another_seed_is_other_noise_under_the_same_labels(used, frame):
    other = used.render(camera(), ALL, "standard", 6, others=others())
    same = {name: digests(other)[name] == digests(frame)[name] for name in ALL}
    assert same == {name: not OUTPUTS[name].traced for name in ALL}
    # Noise it is, and no other picture: before the sensor's noise the two agree to a few per cent.
    difference = np.abs(other["electrons"] - frame["electrons"]).mean()
    assert 0.0 < difference < 0.05 * frame["electrons"].mean()
    assert np.abs(other["colour"].astype(int) - frame["colour"]).mean() < 8


def test_a_partners_photograph_has_noise_of_its_own_and_the_same_light(scene, frame):
    # From the camera's own place it is another photograph of the same thing.
    twin = Renderer(scene).render(camera(), ["colour_stereo"], "standard", 5, others={"stereo": camera()})
    difference = twin["colour_stereo"].astype(float) - frame["colour"]
    assert 0.5 < np.abs(difference).mean() < 8
    assert abs(difference.mean()) < 0.5
    # It is the photograph that a camera there takes.
    partner = others()["stereo"]
    own = Renderer(scene).render(partner, ["colour"], "standard", 77)
    near, far = (
        np.abs(own["colour"] - frame[name].astype(float)).mean() for name in ("colour_stereo", "colour")
    )
    assert near < 0.25 * far
    assert frame.facts["stereo_pose"] == partner.pose.tolist()


def test_the_short_form_gives_the_same_frame(scene, frame):
    short = render_scene(scene, camera(), DEFAULT_OUTPUTS, "standard", 5, others=others())
    assert digests(short) == {name: digests(frame)[name] for name in DEFAULT_OUTPUTS}
    assert list(short.images) == list(DEFAULT_OUTPUTS)


# --- what a frame holds -----------------------------------------------------------------------------------


def test_images_are_as_the_outputs_tell(frame):
    for name in ALL:
        image = frame[name]
        assert OUTPUTS[name].fits(image), name
        assert image.shape[:2] == (camera().sensor.site_shape if name == "raw" else (60, 80)), name
    # The scene is in the picture, and so is the sky behind it.
    assert {0, 1, 2, 4} <= set(np.unique(frame["class"]).tolist())
    assert np.isfinite(frame["electrons"]).all()
    assert frame["electrons"].min() >= 0.0
    assert frame["colour"].std() > 5.0


def test_all_labels_are_about_the_same_hits(frame, scene):
    background = frame["class"] == 0
    np.testing.assert_array_equal(background, frame["instance"] == 0)
    np.testing.assert_array_equal(background, np.isinf(frame["distance"]))
    np.testing.assert_array_equal(background, np.isinf(frame["depth_z"]))
    np.testing.assert_array_equal(background, ~frame["normal"].any(axis=-1))
    classes = np.array([0, *(item.organ_class for item in scene.mesh.instances)])
    np.testing.assert_array_equal(frame["class"], classes[frame["instance"]])
    assert (frame["depth_z"] <= frame["distance"]).all()
    np.testing.assert_allclose(np.linalg.norm(frame["normal"][~background], axis=-1), 1.0, atol=1e-5)


def test_facts_are_plain_json_and_complete(frame, scene):
    facts = json.loads(json.dumps(dict(frame.facts), allow_nan=False))
    assert facts == frame.facts
    assert facts["camera"] == camera().metadata()
    assert facts["seed"] == 5
    assert facts["variant"].endswith("_ad_spectral")
    assert {"pepperscene", "mitsuba", "numpy", "python"} <= set(facts["versions"])
    # Every instance with a pixel is told, and no other.
    seen, pixels = np.unique(frame["instance"], return_counts=True)
    told = facts["instances"]
    assert {value: told[value]["pixels"] for value in told} == {
        str(value): count for value, count in zip(seen.tolist(), pixels.tolist(), strict=True) if value
    }
    for value, item in told.items():
        instance = scene.mesh.instances[int(value) - 1]
        assert (item["class"], item["kind"]) == (int(instance.organ_class), instance.kind)
        assert (item["plant"], item["phytomer"]) == (instance.plant, instance.phytomer)
        # Counted like pixels: 0 is none, and a parent stands before its child.
        assert item["parent"] == instance.parent + 1
        assert 0 <= item["parent"] < int(value)


def test_a_lens_that_distorts_bends_the_picture_and_is_told(used, frame):
    bent = used.render(camera(distorted=True), ["class"], "draft", 5)
    assert bent.facts["camera"]["distortion"]["k1"] == -0.1
    changed = bent["class"] != frame["class"]
    assert changed.any()
    # Nothing moves where the optical axis is.
    assert not changed[28:32, 38:42].any()


def test_a_single_pixel_is_a_picture(used):
    eye = camera(columns=1, rows=1)
    tiny = used.render(eye, ALL, "standard", 5, others={"flow": eye, "stereo": eye})
    for name in ALL:
        assert OUTPUTS[name].fits(tiny[name])
        assert name == "raw" or tiny[name].shape[:2] == (1, 1)
        assert not np.isnan(tiny[name].astype(float)).any()


def test_a_night_without_flash_is_black(scene):
    dark = Renderer(assemble_scene(scene.mesh, {s.name: s for s in scene.surfaces}))
    eye = replace(camera(), flash=None, developing=replace(camera().developing, white_balance="daylight"))
    assert not dark.render(eye, ["electrons", "class"], "standard")["electrons"].any()


# --- what is not asked for is not done --------------------------------------------------------------------


@pytest.fixture
def calls(monkeypatch):
    """Names of the passes that run, in order."""
    made = []

    def watched(module, name):
        inner = getattr(module, name)

        def call(*args, **kwargs):
            made.append(name)
            return inner(*args, **kwargs)

        monkeypatch.setattr(module, name, call)

    for name in ("light_scene", "truth_scene", "sky_tables", "trace", "denoised", "develop"):
        watched(renderer, name)
    for name in ("first_hits", "class_ids", "instance_ids", "normals", "depth_z"):
        watched(labels, name)
    return made


def test_labels_alone_build_no_light(scene, calls):
    made = Renderer(scene).render(camera(), LABELS, others=others())
    assert set(calls) == {
        "truth_scene", "first_hits", "class_ids", "instance_ids", "normals", "depth_z",
    }  # fmt: skip
    assert calls.count("first_hits") == 1
    assert set(made.images) == set(LABELS)


def test_distance_alone_looks_up_no_class_and_no_normal(scene, calls):
    Renderer(scene).render(camera(), ["distance"])
    assert not {"class_ids", "normals", "depth_z", "light_scene"} & set(calls)


def test_colour_alone_casts_no_ray_for_labels(scene, calls):
    made = Renderer(scene).render(camera(), ["colour"], "draft")
    assert set(calls) == {"light_scene", "sky_tables", "trace", "denoised", "develop"}
    assert made.metadata["instances"] == {}


def test_electrons_alone_are_not_developed(scene, calls):
    Renderer(scene).render(camera(), ["electrons"], "draft")
    assert "develop" not in calls


def test_a_partners_photograph_alone_is_one_photograph(scene, calls):
    made = Renderer(scene).render(camera(), ["colour_stereo"], "draft", others=others())
    assert calls == ["light_scene", "sky_tables", "trace", "denoised", "develop"]
    assert set(made.metadata) >= {"sampling_stereo", "stereo_pose"}
    assert "sampling" not in made.metadata


def test_the_reference_is_not_denoised(scene, calls):
    small = camera(columns=8, rows=6)
    light = Renderer(scene).render(small, ["electrons"], "reference")
    assert "denoised" not in calls
    assert light["electrons"].any()


def test_the_path_tracer_serves_frames(scene):
    """As asked for by the quality; its scene is kept along a path and made anew where the flash is gone."""
    plain = replace(
        QUALITIES["reference"], samples=2, soft=2, most=2, bounces=1, integrator="path", sampler="stratified"
    )
    made, seed = Renderer(scene), 9
    number = int(np.random.SeedSequence(seed).spawn(2)[1].generate_state(1)[0])
    for small in (camera(columns=16, rows=12), camera(2, columns=16, rows=12), camera(flash=False)):
        found = made.render(small, ["electrons"], plain, seed)
        signal = path_traced(scene, small, spp=2, bounces=1, sampler="stratified", seed=number)
        assert (found["electrons"] == expected_electrons(signal, small).astype(np.float32)).all()
        assert found["electrons"].any()
        assert found.metadata["sampling"] == {"samples_per_pixel": float(samples_taken("stratified", 2))}


def test_a_scene_is_built_once(scene, calls):
    made = Renderer(scene)
    for step in range(3):
        made.render(camera(step), DEFAULT_OUTPUTS, "draft")
    assert calls.count("light_scene") == 1
    assert calls.count("truth_scene") == 0
    assert calls.count("trace") == 3


def test_labels_alone_import_nothing_that_light_needs():
    heavy = {"pyoidn", "colour", "OpenEXR", "PIL", "skimage", "pepperscene.dataset", "rich", "typer"}
    found = in_a_process(
        "import json, sys\n"
        "from pepperscene.render import Renderer\n"
        "from pepperscene.scene import assemble\n"
        "from greenhouse import camera, row_of_plants\n"
        "Renderer(assemble(row_of_plants())).render(camera(flash=False), ['class', 'instance', 'distance'])\n"
        f"print(json.dumps(sorted({heavy!r} & set(sys.modules))))"
    )
    assert found == []


def test_importing_the_room_does_not_import_mitsuba():
    found = in_a_process(
        "import json, sys\n"
        "import pepperscene.render\n"
        "print(json.dumps(sorted({'mitsuba', 'drjit', 'pyoidn', 'scipy'} & set(sys.modules))))"
    )
    assert found == []


def test_what_further_outputs_need_is_imported_for_them_alone():
    mine = {f"pepperscene.render.{name}" for name in ("coverage", "correspondence", "harvest", "amodal")}
    found = in_a_process(
        "import json, sys\n"
        "from pepperscene.render import Renderer\n"
        "from pepperscene.scene import assemble\n"
        "from greenhouse import camera, row_of_plants\n"
        "made = Renderer(assemble(row_of_plants()))\n"
        "made.render(camera(flash=False), ['class', 'normal', 'position', 'uv'])\n"
        f"before = sorted({mine!r} & set(sys.modules))\n"
        "made.render(camera(flash=False), ['flow', 'coverage'])\n"
        f"print(json.dumps([before, sorted({mine!r} & set(sys.modules))]))"
    )
    assert found == [[], ["pepperscene.render.aov.flow", "pepperscene.render.aov.coverage"]]


# --- refusals ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("outputs", [["depth"], ["colour", "Class"], []])
def test_an_unknown_output_is_the_callers_fault(used, outputs):
    with pytest.raises(InputError, match="colour, raw, electrons, class"):
        used.render(camera(), outputs)


@pytest.mark.parametrize("name", ["stereo", "colour_stereo"])
def test_a_partner_that_is_missing_is_the_callers_fault(used, name):
    with pytest.raises(InputError, match=f"others: stereo: .*{name}"):
        used.render(camera(), [name], others={"flow": camera()})
    with pytest.raises(InputError, match=r"others: left: .*flow, stereo"):
        used.render(camera(), ["class"], others={"left": camera()})


def test_an_unknown_quality_is_the_callers_fault(used):
    with pytest.raises(InputError, match=r"'best'.*draft, standard, reference"):
        used.render(camera(), ["colour"], "best")
    assert [find_quality(name) for name in QUALITIES] == list(QUALITIES.values())


def test_an_unknown_quality_is_refused_whatever_is_asked_for(used):
    with pytest.raises(InputError, match="best"):
        used.render(camera(), ["class"], "best")


def test_colour_needs_surfaces(scene):
    bare = Renderer(assemble_scene(scene.mesh))
    with pytest.raises(ValueError, match="surfaces"):
        bare.render(camera(), ["colour"])
    # Labels do not, neither before nor after.
    assert bare.render(camera(), ["class"])["class"].any()


def test_more_instances_than_the_image_can_tell_apart_are_refused(scene):
    many = replace(scene.mesh, instances=scene.mesh.instances * 600)
    assert len(many.instances) > 65535
    with pytest.raises(ValueError, match="16-bit"):
        Renderer(assemble_scene(many)).render(camera(), ["instance"])
