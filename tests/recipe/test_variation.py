"""Varied values: notation, distributions and levels; twins, rigs, and recipes that extend others."""

from __future__ import annotations

import datetime
import gc
import weakref

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.recipe.resolve.camera_views import CameraViews
from pepperscene.recipe.resolve.frame_setups import FrameSetups, frame_values
from pepperscene.recipe.resolve.load import load_recipe, resolve_recipe


@pytest.fixture
def load(tmp_path):
    def write(text, name="mine.toml", extends="barth2018"):
        path = tmp_path / name
        path.write_text(f'extends = "{extends}"\n{text}\n')
        return load_recipe(path)

    return write


def drawn(recipe, key):
    """The values of the first 24 frames."""
    plan = recipe.plan
    return [frame_values(recipe, plan.frame(index))[1][key] for index in range(min(24, plan.count))]


def test_values_have_the_type_of_their_key(load):
    recipe = load(
        "camera.exposure_us = { auto = 0.5, 50 = 0.5 }\ndeveloping.falloff = { true = 0.5, false = 0.5 }\n"
        "camera.bits = { low = 8, high = 9 }\ncultivar = 'kaite'\n[growth]\nuntil = 'kaite_september'\n"
        "date = { low = 2016-05-01, high = 2016-05-02, per = 'frame' }"
    )
    expected = {
        "camera.exposure_us": ["auto", 50.0], "developing.falloff": [False, True], "camera.bits": [8, 9],
        "growth.date": ["2016-05-01", "2016-05-02"],
    }  # fmt: skip
    for key, values in expected.items():
        assert sorted(set(drawn(recipe, key)), key=str) == sorted(values, key=str)
    first, _ = frame_values(recipe, recipe.plan.frame(0))
    assert isinstance(first.growth.date, datetime.date)


def test_limits_of_a_logarithmic_scale_are_exact(load):
    # exp(log(x)) is not x, and would be outside the range of the key.
    for high in (10_000, 1_000_000, 999_999, 3, 70_001):
        recipe = load(f"camera.exposure_us = {{ low = 1, high = {high}, scale = 'log' }}")
        assert recipe.variation[0].extremes == (1.0, float(high))


def test_values_of_plants_differ_between_sets_and_others_between_frames_by_default(load):
    recipe = load(
        "plan = { sets = 3, rotations = 2, frames = 4 }\nrow.gap_mm = { low = 200, high = 300 }\n"
        "twine.diameter_mm = { low = 2, high = 3 }\ndaylight.cloud_cover = { low = 0, high = 1 }"
    )
    assert [len(set(drawn(recipe, key))) for key in ("row.gap_mm", "twine.diameter_mm")] == [3, 3]
    assert len(set(drawn(recipe, "daylight.cloud_cover"))) == 24


def test_values_in_turn_follow_their_number(load):
    recipe = load(
        "plan = { sets = 2, rotations = 2, frames = 3 }\ncamera.gain = { in_turn = [1, 2, 3, 4] }\n"
        "daylight.sun_azimuth_deg = { in_turn = [60, -120], per = 'set' }"
    )
    assert drawn(recipe, "camera.gain") == [1, 2, 3, 4] * 3
    assert drawn(recipe, "daylight.sun_azimuth_deg") == [60] * 6 + [-120] * 6


def test_values_in_lists_vary_and_the_others_stay(load):
    recipe = load("developing.white_balance_error = [{ low = 0.9, high = 1.1 }, 1, { in_turn = [0.8, 1.2] }]")
    errors = [frame_values(recipe, recipe.plan.frame(i))[0].developing.white_balance_error for i in range(20)]
    assert len({red for red, _, _ in errors}) == 20
    assert {green for _, green, _ in errors} == {1.0}
    assert [blue for _, _, blue in errors] == [0.8, 1.2] * 10


@pytest.fixture
def cultivars(tmp_path):
    """The set-ups of the six sets of a recipe with other values of its cultivar."""

    def make(text):
        path = tmp_path / "mine.toml"
        path.write_text(f'extends = "barth2018"\n{text}')
        resolved = resolve_recipe(path)
        setups = FrameSetups(resolved)
        return [setups.at(resolved.recipe.plan.frame(number * 7 * 250)) for number in range(6)]

    return make


def test_values_of_the_cultivar_vary(cultivars):
    for setup in cultivars(
        "[override.organs.fruit.diameter]\n"
        'mean_mm = { low = 60, high = 80, per = "set" }\n'
        'sd_mm = 4\nchosen = "x"\n[override.stem]\nparts = { low = 10, high = 12, per = "set" }\n'
        '[override.organs.fruit.ripe_fraction]\nvalue = 0.5\nchosen = "x"\n'
    ):
        diameter = setup.cultivar.organs["fruit"].distributions["diameter"]
        mean_mm = setup.drawn["override.organs.fruit.diameter.mean_mm"]
        assert diameter.mean == pytest.approx(mean_mm / 1e3)
        assert 60 <= mean_mm <= 80
        assert setup.cultivar.stem.parts == setup.drawn["override.stem.parts"]
        assert setup.cultivar.stem.parts in (10, 11, 12)


def test_values_in_lists_of_the_cultivar_vary(cultivars):
    """The bins of a histogram, whose weights keep their sum, and a limit."""
    highs = set()
    for setup in cultivars(
        "[override.organs.lamina]\n"
        'residue = { uniform = [0, { low = 0.1, high = 0.5, per = "set" }], chosen = "x" }\n'
        "ageing = { histogram = [\n"
        '    [0, 0, { low = 0.5, high = 1, per = "set", draw = "age" }],\n'
        '    [0.1, 0.3, { low = 0, high = 0.5, per = "set", draw = "age", reversed = true }],\n'
        '], chosen = "x" }\n'
    ):
        lamina = setup.cultivar.organs["lamina"].distributions
        highs.add(lamina["residue"].high)
        assert lamina["residue"].high == setup.drawn["override.organs.lamina.residue.uniform.1"]
        healthy = setup.drawn["override.organs.lamina.ageing.histogram.0.2"]
        assert lamina["ageing"].bins[0] == pytest.approx((0.0, 0.0, healthy))
    assert len(highs) == 6


TWINS = (
    "plan = { sets = 2, rotations = 1, frames = 3 }\ncamera.focus_mm = { low = 300, high = 500 }\n"
    "row.gap_mm = { low = 200, high = 300 }\n"
)


def test_twins_of_a_moment_have_their_own_values_and_the_same_draws(load):
    recipe = load(TWINS + "[twins]\n'camera.gain' = [1, 2, 4]\n'camera.bits' = [8, 10, 12]")
    plan = recipe.plan
    assert plan.count == 2 * 3 * 3
    moments = {}
    for index in range(plan.count):
        spec = plan.frame(index)
        camera = frame_values(recipe, spec)[0].camera
        assert (camera.gain, camera.bits) == [(1, 8), (2, 10), (4, 12)][spec.twin]
        moments.setdefault(spec.moment, []).append((spec.twin, camera.focus_m))
    assert sorted(moments) == list(range(6))
    assert all([twin for twin, _ in pairs] == [0, 1, 2] for pairs in moments.values())
    assert all(len({focus for _, focus in pairs}) == 1 for pairs in moments.values())
    assert len({pairs[0][1] for pairs in moments.values()}) == 6


def test_a_list_of_twins_replaces_the_varied_values_in_it(load):
    recipe = load(
        "developing.white_balance_error = [{ low = 0.9, high = 1.1 }, 1, 1]\n"
        "[twins]\n'developing.white_balance_error' = [[1, 1, 1], [1.2, 1, 1]]"
    )
    assert recipe.variation == ()
    last, drawn = frame_values(recipe, recipe.plan.frame(recipe.plan.count - 1))
    assert drawn == {"developing.white_balance_error": [1.2, 1, 1]}
    assert last.developing.white_balance_error == (1.2, 1, 1)


@pytest.mark.long
def test_parts_that_differ_in_every_frame_do_not_pile_up_in_memory(load):
    recipe = load("plan.frames = 200\noverride.stem.parts = { low = 20, high = 170, per = 'frame' }")
    setups, first = FrameSetups(resolve_recipe(recipe)), recipe.plan.frame(0)
    cultivar = weakref.ref(setups.at(first).cultivar)
    parts = cultivar().stem.parts
    for index in range(1, 200):
        setups.at(recipe.plan.frame(index))
    gc.collect()
    assert cultivar() is None
    assert setups.at(first).cultivar.stem.parts == parts


RIG = (
    "plan = { sets = 1, rotations = 1, frames = 4 }\nviews.speed_mm_s = 500\ncamera.focus_mm = 600\n"
    "[[rig]]\nname = 'right'\nposition_mm = [80, -20, 10]\nrotation_deg = [10, 20, 30]\ngain = 2\n"
)


def rig_views(recipe):
    return CameraViews(FrameSetups(resolve_recipe(recipe, allow_code=True)))


@pytest.fixture
def rig(load):
    """The main camera and that of the rig, at two moments."""
    recipe = load(RIG)
    views = rig_views(recipe)
    return [[views.camera(recipe.plan.frame(2 * moment + n)) for n in range(2)] for moment in (1, 2)]


def test_a_camera_of_the_rig_has_the_place_and_axes_that_scipy_gives(rig):
    main, other = rig[1]
    expected = np.eye(4)
    # To the right about the down axis, upwards about the right axis, clockwise about the optical axis.
    turned = Rotation.from_rotvec(np.radians(10) * np.array([0.0, 1.0, 0.0]))
    raised = Rotation.from_rotvec(np.radians(20) * turned.apply([1.0, 0.0, 0.0])) * turned
    expected[:3, :3] = (
        Rotation.from_rotvec(np.radians(30) * raised.apply([0.0, 0.0, 1.0])) * raised
    ).as_matrix()
    expected[:3, 3] = [0.08, -0.02, 0.01]
    np.testing.assert_allclose(other.pose, main.pose @ expected, atol=1e-12)
    # To the right and upwards of the main camera's axis: y is down.
    right, down, forward = expected[:3, 2]
    assert right > 0 > down
    assert forward > 0
    # The flash stays at the main camera: emitters in the world, from the axes of each camera.
    places = [
        camera.flash.emitter_positions() @ camera.pose[:3, :3].T + camera.pose[:3, 3]
        for camera in (main, other)
    ]
    np.testing.assert_allclose(places[0], places[1], atol=1e-12)


def test_a_camera_of_the_rig_moves_with_the_main_camera(rig):
    main, other = rig[0]
    extrinsics = np.linalg.inv(main.pose) @ other.pose
    step_s = 1e-4
    moved = [camera.motion.pose_at(camera.pose, step_s) for camera in (main, other)]
    # A rigid body: first-order in the step.
    np.testing.assert_allclose(moved[1], moved[0] @ extrinsics, atol=1e-7)
    assert np.linalg.norm(other.motion.velocity_m_s - main.motion.velocity_m_s) > 1e-3


def test_cameras_that_are_drawn_for_each_frame_have_their_own_frustums(load):
    # Far more cameras than are kept at a time.
    recipe = load(
        "plan = { sets = 1, rotations = 1, frames = 60 }\n"
        "[camera]\nhfov_deg = { low = 20, high = 90 }\nwidth = 64\nheight = 48\nsensor = 'generic_rgb'"
    )
    views, specs = rig_views(recipe), [recipe.plan.frame(index) for index in range(60)]
    together = views.frustums(specs)
    alone = [views.frustums([spec]) for spec in specs]
    normals = np.concatenate([part.normals for part in alone])
    np.testing.assert_array_equal(together.normals, normals)


def test_twins_with_other_views_have_their_own_poses_in_any_order(tmp_path):
    (tmp_path / "views.py").write_text(
        "import numpy as np\ndef near(scene, rng):\n    poses = np.tile(np.eye(4), (2, 1, 1))\n"
        "    poses[:, 0, 3] = rng.random(2)\n    return poses\n"
        "def far(scene, rng):\n    poses = near(scene, rng)\n    poses[:, 0, 3] += 5\n    return poses\n"
    )
    path = tmp_path / "mine.toml"
    path.write_text(
        "extends = 'barth2018'\nplan = { sets = 1, rotations = 1, frames = 2 }\n"
        "[views]\nkind = 'function'\nfile = 'views.py'\n[twins]\n'views.function' = ['near', 'far']\n"
    )
    recipe = load_recipe(path)
    specs = [recipe.plan.frame(index) for index in range(4)]
    scene = type("StandIn", (), {})()
    forwards, backwards = rig_views(recipe), rig_views(recipe)
    first = [forwards.view(spec, scene).pose for spec in specs]
    last = [backwards.view(spec, scene).pose for spec in reversed(specs)][::-1]
    np.testing.assert_array_equal(first, last)
    np.testing.assert_allclose(first[2][0, 3] - first[0][0, 3], 5)


def test_varied_values_replace_values_and_are_replaced(load):
    load("camera.gain = { low = 1, high = 2 }\ncamera.focus_mm = { mean = 400, sd = 9 }", "parent.toml")
    child = load("camera.gain = 3\ncamera.focus_mm = { low = 300, high = 500 }", extends="parent.toml")
    assert [varied.name for varied in child.variation] == ["camera.focus_mm"]
    assert child.variation[0].extremes == (300.0, 500.0)
    assert child.camera.gain == 3
    assert load_recipe("barth2018", {"camera.gain": {"low": 1, "high": 2}}).variation[0].name == "camera.gain"


def test_views_of_another_kind_replace_the_table_and_the_number_of_frames(load):
    grid = load("[views]\nkind = 'grid'\ndistance_mm = [400, 500]\nheight_mm = [900, 1000, 1100]")
    assert grid.plan.frames == 6
    assert grid.views.pitch_rad == (0.0,)
    path = load(
        "[views]\nkind = 'path'\npoints_mm = [[0, -600, 1000], [1000, -600, 1000]]\n"
        "speed_mm_s = 100\nframe_rate_hz = 2"
    )
    # Ten seconds, both ends included.
    assert path.plan.frames == 21
    assert load("views.distance_mm = 500").plan.frames == 250


@pytest.mark.parametrize(
    ("text", "changes", "kept"),
    [
        ("seed = 3", {}, True),
        ("camera.gain = 2", {}, True),
        ("plan.frames = 251", {}, False),
        ("views.distance_mm = 500", {}, False),
        ("seed = 3", {"views.distance_mm": 500}, True),
        ("seed = 3", {"plan.sets": 7}, False),
        ("plan.select = []", {}, False),
        ("plan = { sets = 7, select = [1] }", {}, True),
    ],
)
def test_other_frames_drop_an_inherited_selection(tmp_path, text, changes, kept):
    path = tmp_path / "mine.toml"
    path.write_text(f"extends = 'demo'\n{text}\n")
    recipe = load_recipe(path, changes)
    assert (recipe.plan.select is not None) == kept
    indices = recipe.plan.select_indices(None)
    assert len(indices) == (len(recipe.plan.select) if kept else recipe.plan.count)


def test_files_that_outcomes_twins_and_rigs_name_are_beside_the_recipe(tmp_path):
    from pepperscene.shipped import shipped_folder

    (tmp_path / "mine").mkdir()
    lens = (shipped_folder("materials") / "lenses" / "lensagon_cmfa0420nd.toml").read_text()
    for name in ("a", "b", "c", "d"):
        (tmp_path / "mine" / f"{name}.toml").write_text(lens)
    path = tmp_path / "mine.toml"
    path.write_text(
        "extends = 'barth2018'\n[camera]\nlens = { 'mine/a.toml' = 0.5, lensagon_cmfa0420nd = 0.5 }\n"
        "[twins]\n'camera.lens' = ['mine/b.toml', 'mine/c.toml']\n[[rig]]\nname = 'r'\nlens = 'mine/d.toml'\n"
    )
    recipe = load_recipe(path)
    assert recipe.variation[0].extremes[0] == str(tmp_path / "mine" / "a.toml")
    assert recipe.twins["camera.lens"][1] == str(tmp_path / "mine" / "c.toml")
    assert recipe.rig[0].camera["lens"] == str(tmp_path / "mine" / "d.toml")
    before = recipe.sha256()
    for name in ("a", "b", "c", "d"):
        file = tmp_path / "mine" / f"{name}.toml"
        file.write_text(lens.replace('name = "', 'name = "my '))
        after = load_recipe(path).sha256()
        assert after != before
        before = after


def test_the_shipped_randomised_recipe_has_a_valid_recipe_for_every_set():
    renderer = FrameRenderer("randomised")
    plan = renderer.recipe.plan
    for index in range(0, plan.count, plan.frames):
        assert renderer.setups.at(plan.frame(index)).camera.width == 800


def test_a_camera_of_the_rig_with_another_lens_replaces_the_main_one(load):
    recipe = load("[[rig]]\nname = 'wide'\nhfov_deg = 80\nwidth = 64\nheight = 48\nsensor = 'generic_rgb'")
    camera = rig_views(recipe).camera(recipe.plan.frame(1))
    assert camera.intrinsics[0, 0] == pytest.approx(32 / np.tan(np.radians(40)))
