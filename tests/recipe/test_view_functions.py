"""Functions of the user that give views: read-only scenes, one-sentence errors, and the recorded poses."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
import pytest

from pepperscene.building.execution.job import FrameMaker
from pepperscene.dataset.store.frame_json import FrameStatus
from pepperscene.errors import InputError
from pepperscene.frame import Frame
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import grow
from pepperscene.recipe.views.user_function import function_poses
from pepperscene.recipe.views_tables import FunctionViews
from pepperscene.scene import Skeleton, assemble_scene

FUNCTION = """
import numpy as np
def poses(scene, rng):
    {body}
    return np.tile(np.eye(4), (2, 1, 1))
"""


@pytest.fixture(scope="module")
def scene(kaite):
    plant = grow(kaite, np.random.default_rng(0))
    mesh = mesh_plant(plant, 0.1)
    skeleton = Skeleton((plant,), (len(mesh.instances),), np.zeros((1, 3)), np.zeros(1), ())
    return assemble_scene(mesh, skeleton=skeleton)


@pytest.fixture(scope="module")
def kaite():
    from pepperscene.cultivar import load_cultivar

    cultivar = load_cultivar("kaite")
    return cultivar.model_copy(update={"stem": cultivar.stem.model_copy(update={"parts": 2})})


@pytest.fixture
def call(tmp_path, scene):
    def run(body):
        file = tmp_path / "views.py"
        file.write_text(FUNCTION.format(body=body))
        table = FunctionViews(kind="function", file=str(file))
        return function_poses(table, scene, np.random.default_rng(1), 2)

    return run


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        ("raise GeneratorExit", "failed with GeneratorExit"),
        ("raise BaseException('stop')", "failed with BaseException: stop"),
        ("raise SystemExit(0)", "failed with SystemExit"),
        ("raise KeyError('two\\nlines')", "failed with KeyError"),
        ("assert False", r"failed with AssertionError$"),
        ("scene.mesh.vertices += 5", "read-only"),
        ("scene.mesh.faces.sort(axis=0)", "read-only"),
        ("scene.mesh.normals.fill(0)", "read-only"),
        ("scene.skeleton.bases[0] = 1", "read-only"),
        ("scene.skeleton.plants[0].organs[0].curve[0] = 1", "read-only"),
        ("scene.skeleton.plants[0].organs[0].measures['length_m'] = 1", "failed with TypeError"),
        ("scene.mesh.vertices = None", "failed with FrozenInstanceError"),
        ("return np.eye(4)", r"must return finite poses of the shape \(2, 4, 4\)"),
        ("return [[1], [1, 2]]", "failed with ValueError"),
        ("return np.stack([np.diag([-1, 1, 1, 1.0])] * 2)", "without scale or reflection"),
        ("return np.stack([np.diag([1, 1, 1, 0.0])] * 2)", "without scale or reflection"),
        ("p = np.tile(np.eye(4), (2, 1, 1)); p[1, 0, 3] = -1e7; return p", "pose 1: must have a position"),
        ("p = np.tile(np.eye(4), (2, 1, 1)); p[1, 0, 3] = np.nan; return p", "must return finite poses"),
    ],
)
def test_faults_of_a_function_are_one_sentence(call, scene, body, problem):
    before = scene.mesh.vertices.copy()
    with pytest.raises(InputError, match=problem) as caught:
        call(body)
    assert caught.value.where.endswith("views.py")
    assert "\n" not in str(caught.value)
    np.testing.assert_array_equal(scene.mesh.vertices, before)


def test_a_user_who_interrupts_a_function_interrupts_the_program(call):
    with pytest.raises(KeyboardInterrupt):
        call("raise KeyboardInterrupt")


def test_the_scene_itself_stays_writable_and_shares_its_memory(call, scene):
    assert len(call("assert not scene.mesh.vertices.flags.writeable")) == 2
    assert scene.mesh.vertices.flags.writeable
    assert not isinstance(scene.skeleton.plants[0].organs[0].measures, MappingProxyType)


def test_what_a_function_prints_goes_to_standard_error(call, capsys):
    call("print('from the function')")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "from the function" in captured.err


class OneFrame:
    """Stands in for the renderer of a build."""

    def __init__(self, pose):
        self.pose = pose

    def render(self, spec, outputs, quality):
        return Frame(dict.fromkeys(outputs), {"camera": {"pose": self.pose.tolist()}})


@pytest.mark.parametrize(("shift_m", "is_same"), [(0.0, True), (1e-3, False)])
def test_outputs_are_added_to_the_recorded_pose_only(recipe, tmp_path, monkeypatch, shift_m, is_same):
    from pepperscene.building.execution.job import BuildJob, BuildOptions
    from pepperscene.recipe.resolve.resolved import load_files

    (tmp_path / "views.py").write_text(FUNCTION.format(body="pass"))
    table = FunctionViews(kind="function", file=str(tmp_path / "views.py"))
    resolved = load_files(recipe.model_copy(update={"views": table}))
    job = BuildJob.create(resolved, tmp_path / "set", ("class", "distance"), BuildOptions())
    pose = np.eye(4)
    pose[0, 3] = shift_m
    status = FrameStatus({"camera": {"pose": np.eye(4).tolist()}}, {"class": {}}, "sum", "sum")
    written = []
    with FrameMaker(job) as maker:
        maker._renderer = OneFrame(pose)
        monkeypatch.setattr(type(maker._folder.dataset), "intact", lambda self, index: status)
        monkeypatch.setattr(FrameMaker, "_write", lambda self, spec, *rest: written.append(spec.index))
        if is_same:
            maker.make([0], lambda done: None)
            assert written == [0]
        else:
            with pytest.raises(InputError, match="gives another pose for frame 0"):
                maker.make([0], lambda done: None)
            assert not written
