"""Scenes as GLB, USD and SDF, read back by trimesh and usd-core, and compared with a frame of the recipe."""

import itertools
import json
import sys
from contextlib import suppress
from dataclasses import replace
from io import BytesIO
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from PIL import Image
from row_cache import rows_from
from scene_files import cast_rays, glb_json, glb_nodes, usd_nodes

import pepperscene as ps
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera.image.colorimetry import srgb_decode
from pepperscene.errors import ArgumentError, InputError, OutputError, SetupError
from pepperscene.export.simulators.contents import scene_contents
from pepperscene.scene import assemble_scene

FRAME = 125
CHANGES = {
    "cultivar": "kaite_february",
    "camera.width": 160,
    "camera.height": 120,
    "row.plants_front": 2,
    "row.plants_back": 0,
}
RAYS = 1000


@pytest.fixture(scope="module")
def small(rows):
    """A small row, its recipe, and a view of it."""
    recipe = ps.load_recipe("barth2018", CHANGES)
    with rows_from(rows):
        frames = FrameRenderer(recipe, culled=False)
        spec = recipe.plan.frame(FRAME)
        scene, sky = frames.scene(spec), frames.sky(spec)
    camera = frames.camera(spec, traced=False).at_pose(ps.look_at((0.3, -0.5, 0.5), (0.2, 0.0, 0.25)))
    frame = ps.Renderer(scene).render(camera, ["class", "instance", "depth_z", "harvest", "albedo"])
    return SimpleNamespace(recipe=recipe, scene=scene, sky=sky, frame=frame, camera=camera)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("scenes")


@pytest.fixture(scope="module")
def glb(small, folder):
    return ps.export_scene(small.scene, folder / "row.glb", camera=small.camera)


@pytest.fixture(scope="module")
def usd(small, folder):
    pytest.importorskip("pxr")
    scene = replace(small.scene, sky=small.sky)
    return ps.export_scene(scene, folder / "row.usdc", camera=small.camera)


@pytest.fixture(scope="module")
def sdf(small, folder):
    return ps.export_scene(small.scene, folder / "row.sdf", camera=small.camera)


@pytest.fixture(scope="module")
def read_glb(glb):
    return glb_nodes(glb[0])


@pytest.fixture(scope="module")
def read_usd(usd):
    return usd_nodes(usd[0])


@pytest.fixture(params=["glb", "usd"])
def nodes(request):
    """The nodes of each format in turn."""
    return request.getfixturevalue(f"read_{request.param}")


def test_every_organ_is_a_node_with_its_name_class_and_number(small, nodes):
    instances = small.scene.mesh.instances
    organs = {
        node.extras["instance"]: (name, node) for name, node in nodes.items() if "instance" in node.extras
    }
    assert sorted(organs) == list(range(1, len(instances) + 1))
    for index, item in enumerate(instances):
        name, node = organs[index + 1]
        assert item.kind in name
        assert (node.extras["class_id"], node.extras["kind"]) == (item.class_id, item.kind)
        assert (node.extras["plant"], node.extras["phytomer"]) == (item.plant, item.phytomer)
        assert node.extras["parent"] == item.parent + 1
        expected = small.scene.mesh.vertices[small.scene.mesh.faces[small.scene.mesh.face_instance == index]]
        np.testing.assert_allclose(node.triangles, expected, atol=2e-6)
    assert {"plant_0", "plant_1"} <= set(nodes)


def test_fruit_have_the_truth_of_the_frame(small, nodes):
    """The output harvest gives poses in camera axes, and points in world axes."""
    organs = {node.extras["instance"]: node for node in nodes.values() if "instance" in node.extras}
    fruit = [item for item in organs.values() if "ripeness" in item.extras]
    assert len(fruit) == len(small.scene.skeleton.of_form("fruit"))
    seen = small.frame["harvest"]["fruit"]
    assert seen
    for truth in seen:
        node = organs[truth["instance"]]
        np.testing.assert_allclose(node.pose, small.camera.pose @ truth["pose"], atol=1e-6)
        assert node.extras["ripeness"] == pytest.approx(truth["ripeness"], abs=1e-6)
        cut = truth["peduncle"]["cut"]
        np.testing.assert_allclose(node.extras["cut_point_m"], cut["world_m"], atol=1e-6)
        local = np.append(node.extras["cut_point_local_m"], 1.0)
        np.testing.assert_allclose((node.pose @ local)[:3], cut["world_m"], atol=3e-6)
        np.testing.assert_allclose(node.extras["size_m"], truth["box_3d"]["size"], atol=1e-6)
        assert node.extras["stalk"] == truth["peduncle"]["instance"]


def test_poses_of_the_json_are_those_of_the_nodes(glb, read_glb, small):
    content = json.loads(glb[-1].read_text(encoding="utf-8"))
    for entry in (*content["organs"], *content["plants"]):
        np.testing.assert_allclose(read_glb[entry["name"]].pose, entry["pose"], atol=2e-6)
    assert content["camera"]["width"] == 160
    np.testing.assert_allclose(content["camera"]["pose"], small.camera.pose)
    # The root of a plant is the foot of its stem.
    for number, plant in enumerate(content["plants"]):
        foot = small.scene.mesh.vertices[small.scene.mesh.faces[small.scene.mesh.face_instance == 0]]
        if number == 0:
            np.testing.assert_allclose(np.array(plant["pose"])[:2, 3], foot.mean(axis=(0, 1))[:2], atol=0.01)


def test_rays_through_pixels_end_at_their_depth(small, nodes):
    depth = small.frame["depth_z"]
    rng = np.random.default_rng(1)
    hit = np.argwhere(np.isfinite(depth) & (depth > 0))
    pixels = hit[rng.choice(len(hit), RAYS, replace=False)]
    directions = small.camera.pixel_directions()[pixels[:, 0], pixels[:, 1]]
    found = cast_rays(nodes, small.camera.pose, directions[:, :2] / directions[:, 2:])
    np.testing.assert_allclose(found, depth[pixels[:, 0], pixels[:, 1]], atol=1e-3)


def test_textures_have_the_colours_of_the_render(small, glb, read_glb):
    """Where an organ is seen, its mean colour is near the albedo that the camera measures there."""
    scene = trimesh.load_scene(glb[0])
    assert {one["name"] for one in glb_json(glb[0])["materials"]} <= {*small.scene.mesh.surfaces}
    instance, albedo = small.frame["instance"], small.frame["albedo"].astype(float)
    for class_id, name in ((1, "leaf"), (2, "pepper"), (4, "stem")):
        rendered, baked, weights = [], [], []
        for node_name, node in read_glb.items():
            if node.extras.get("class") != name:
                continue
            seen = instance == node.extras["instance"]
            if not seen.any():
                continue
            visual = scene.geometry[node_name].visual
            image = np.asarray(visual.material.baseColorTexture.convert("RGB"), dtype=float) / 255.0
            height, width = image.shape[:2]
            columns = np.clip((visual.uv[:, 0] * width).astype(int), 0, width - 1)
            rows = np.clip(((1.0 - visual.uv[:, 1]) * height).astype(int), 0, height - 1)
            baked.append(srgb_decode(image[rows, columns]).mean(axis=0))
            rendered.append(albedo[seen].mean(axis=0))
            weights.append(seen.sum())
        assert weights, class_id
        mean = [np.average(values, axis=0, weights=weights) for values in (rendered, baked)]
        # Leaves are seen from both sides, and their paler back is not baked.
        np.testing.assert_allclose(mean[1], mean[0], atol=0.06, err_msg=name)
        assert np.argmax(mean[1]) == np.argmax(mean[0])


def test_usd_has_images_beside_it_and_all_materials_show_them(usd):
    from pxr import Usd, UsdShade

    stage = Usd.Stage.Open(str(usd[0]))
    found = set()
    for prim in stage.Traverse():
        shader = UsdShade.Shader(prim)
        if shader and shader.GetIdAttr().Get() == "UsdUVTexture":
            path = shader.GetInput("file").Get()
            found.add(path.path)
            with Image.open(path.resolvedPath) as image:
                assert image.mode == "RGB"
    assert found == {f"./{file.name}" for file in usd if file.suffix == ".png"}


def test_usd_is_valid(usd):
    from pxr import Usd, UsdGeom, UsdUtils

    stage = Usd.Stage.Open(str(usd[0]))
    assert (UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)) == (1.0, "Z")
    if hasattr(UsdUtils, "ComplianceChecker"):
        from pxr import Sdr, Tf

        # Wheels of usd-core lack the definitions of shaders: the first look-up raises, and the check of their
        # types fails for each.
        with suppress(Tf.ErrorException):
            Sdr.Registry().GetShaderNodeByIdentifier("UsdPreviewSurface")
        checker = UsdUtils.ComplianceChecker(arkit=False, skipARKitRootLayerCheck=True)
        checker.CheckCompliance(str(usd[0]))
        found = checker.GetErrors() + checker.GetFailedChecks() + checker.GetWarnings()
        assert [text for text in found if "ShaderPropertyTypeConformanceChecker" not in text] == []
    else:
        # Newer versions have validators in its place.
        from pxr import UsdValidation

        validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
        errors = UsdValidation.ValidationContext(validators).Validate(stage)
        assert [error.GetMessage() for error in errors] == []


def test_usd_has_labels_of_both_schemas(usd):
    from pxr import Usd, UsdGeom, UsdSemantics

    stage = Usd.Stage.Open(str(usd[0]))
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            name = prim.GetAttribute("userProperties:class").Get()
            assert list(UsdSemantics.LabelsAPI(prim, "class").GetLabelsAttr().Get()) == [name]
            assert "SemanticsAPI:Semantics" in prim.GetMetadata("apiSchemas").GetAppliedItems()
            assert prim.GetAttribute("semantic:Semantics:params:semanticType").Get() == "class"
            assert prim.GetAttribute("semantic:Semantics:params:semanticData").Get() == name


def test_usd_fruit_are_bodies_that_hang_at_their_cut(usd, read_usd, small):
    from pxr import Usd, UsdGeom, UsdPhysics

    stage, cache, joints = Usd.Stage.Open(str(usd[0])), UsdGeom.XformCache(), 0
    for prim in stage.Traverse():
        if not prim.IsA(UsdPhysics.FixedJoint):
            continue
        joints += 1
        joint = UsdPhysics.FixedJoint(prim)
        frames = []
        for rel, position in (
            (joint.GetBody0Rel(), joint.GetLocalPos0Attr()),
            (joint.GetBody1Rel(), joint.GetLocalPos1Attr()),
        ):
            body = stage.GetPrimAtPath(rel.GetTargets()[0])
            frames.append(cache.GetLocalToWorldTransform(body).Transform(position.Get()))
        fruit = next(one for one in body.GetChildren() if one.GetName().startswith(body.GetName()[5:]))
        cut = fruit.GetAttribute("userProperties:cut_point_m").Get()
        np.testing.assert_allclose(frames, [cut, cut], atol=2e-6)
        assert body.HasAPI(UsdPhysics.RigidBodyAPI)
        assert UsdPhysics.MeshCollisionAPI(fruit).GetApproximationAttr().Get() == "convexHull"
        # Its hull is hardly larger than a fruit, which is half as dense as water.
        triangles = read_usd[fruit.GetName()].triangles
        volume = trimesh.Trimesh(
            triangles.reshape(-1, 3), np.arange(triangles.size // 3).reshape(-1, 3)
        ).volume
        mass = UsdPhysics.MassAPI(body).GetMassAttr().Get()
        assert 500.0 * volume * 0.99 <= mass <= 500.0 * volume * 1.3
        assert 0.0 < joint.GetBreakForceAttr().Get() < np.inf
    assert joints == len(small.scene.skeleton.of_form("fruit"))


def test_usd_camera_and_sun_are_those_of_the_frame(usd, small):
    from pxr import Gf, Usd, UsdGeom, UsdLux

    stage = Usd.Stage.Open(str(usd[0]))
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/World/camera")).GetCamera(Usd.TimeCode.Default())
    matrix = camera.frustum.ComputeViewMatrix() * camera.frustum.ComputeProjectionMatrix()
    axes, origin = small.camera.pose[:3, :3], small.camera.pose[:3, 3]
    points = origin + np.array([[0.1, 0.05, 1.0], [-0.2, 0.1, 0.8], [0.0, 0.0, 2.0]]) @ axes.T
    device = np.array([matrix.Transform(Gf.Vec3d(*point)) for point in points])
    pixels = (device[:, :2] * [0.5, -0.5] + 0.5) * [small.camera.width, small.camera.height]
    # The lens has no distortion.
    np.testing.assert_allclose(pixels, small.camera.project(points), atol=1e-3)
    light = UsdLux.DistantLight(stage.GetPrimAtPath("/World/sun"))
    turn = UsdGeom.XformCache().GetLocalToWorldTransform(light.GetPrim())
    np.testing.assert_allclose(turn.TransformDir(Gf.Vec3d(0, 0, 1)), small.sky.sun.direction, atol=1e-6)
    level = light.GetIntensityAttr().Get() * small.sky.sun.direction[2]
    dome = UsdLux.DomeLight(stage.GetPrimAtPath("/World/sky")).GetIntensityAttr().Get()
    for path in ("sun", "sky"):
        colour = UsdLux.LightAPI(stage.GetPrimAtPath(f"/World/{path}")).GetColorAttr().Get()
        assert np.dot(colour, [0.2126, 0.7152, 0.0722]) == pytest.approx(1.0, abs=1e-3)
    assert level + np.pi * dome == pytest.approx(small.sky.horizontal_illuminance(), rel=1e-3)


# --- SDF ----------------------------------------------------------------------------------------------------

RULES = {
    # Element: required attributes, required children, allowed children. From sdformat.org/spec, version 1.9.
    "sdf": ({"version"}, set(), {"model"}),
    "model": ({"name"}, {"link"}, {"link", "joint", "plugin", "pose", "static"}),
    "link": ({"name"}, set(), {"pose", "inertial", "visual", "collision"}),
    "inertial": (set(), set(), {"pose", "mass", "inertia"}),
    "inertia": (set(), {"ixx", "iyy", "izz"}, {"ixx", "ixy", "ixz", "iyy", "iyz", "izz"}),
    "visual": ({"name"}, {"geometry"}, {"pose", "geometry", "plugin"}),
    "collision": ({"name"}, {"geometry"}, {"pose", "geometry"}),
    "geometry": (set(), set(), {"mesh"}),
    "mesh": (set(), {"uri"}, {"uri", "submesh", "scale"}),
    "submesh": (set(), {"name"}, {"name", "center"}),
    "joint": ({"name", "type"}, {"parent", "child"}, {"parent", "child", "pose"}),
}


def test_sdf_follows_the_rules_of_the_format(sdf):
    root = ElementTree.parse(sdf[0]).getroot()
    assert root.tag == "sdf"
    for element in root.iter():
        if element.tag in RULES:
            attributes, required, allowed = RULES[element.tag]
            children = [child.tag for child in element]
            assert attributes <= set(element.keys())
            assert required <= set(children) <= allowed
        elif element.tag == "pose":
            assert len(element.text.split()) == 6
        elif element.tag == "plugin":
            assert {"filename", "name"} <= set(element.keys())
    for tag in ("link", "visual", "collision"):
        names = [one.get("name") for one in root.iter(tag)]
        assert len(set(names)) == len(names)
    for uri in root.iter("uri"):
        assert (sdf[0].parent / uri.text).is_file()
    config = ElementTree.parse(sdf[1]).getroot()
    assert config.findtext("sdf") == "model.sdf"
    assert {file.name for file in sdf} == {path.name for path in sdf[0].parent.rglob("*") if path.is_file()}


def pose_matrix(text):
    """`(4, 4)` of a pose of SDF."""
    x, y, z, roll, pitch, yaw = map(float, (text or "0 0 0 0 0 0").split())
    matrix = trimesh.transformations.euler_matrix(roll, pitch, yaw, "sxyz")
    matrix[:3, 3] = x, y, z
    return matrix


def test_sdf_shows_the_triangles_of_the_scene_with_their_labels(sdf, small):
    mesh = small.scene.mesh
    shown = trimesh.load_scene(sdf[0].parent / "meshes" / "scene.glb")
    triangles, labels = [], []
    for link in ElementTree.parse(sdf[0]).getroot().iter("link"):
        for visual in link.iter("visual"):
            name = visual.findtext("geometry/mesh/submesh/name")
            # Gazebo applies the transforms of nodes and takes the coordinates as they are.
            matrix = pose_matrix(link.findtext("pose")) @ pose_matrix(visual.findtext("pose"))
            to_root, geometry = shown.graph.get(name)
            points = shown.geometry[geometry].triangles.reshape(-1, 3)
            found = trimesh.transform_points(points, matrix @ to_root).reshape(-1, 3, 3)
            triangles.append(found)
            labels.append(np.full(len(found), int(visual.findtext("plugin/label"))))
    triangles, labels = np.concatenate(triangles), np.concatenate(labels)
    expected = mesh.vertices[mesh.faces]
    assert len(triangles) == len(expected)
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(triangles.reshape(-1, 9)).query(expected.reshape(-1, 9))
    assert distance.max() < 1e-5
    np.testing.assert_array_equal(labels[nearest], mesh.face_class)


def test_sdf_fruit_fall_as_hulls_when_they_are_cut(sdf, small):
    root = ElementTree.parse(sdf[0]).getroot()
    links = {link.get("name"): link for link in root.iter("link")}
    plugins = root.findall("model/plugin")
    assert len(plugins) == len(small.scene.skeleton.of_form("fruit")) == len(links) - 1
    for plugin in plugins:
        link = links[plugin.findtext("child_link")]
        assert plugin.findtext("child_model") == "__model__"
        assert plugin.findtext("detach_topic") == f"/model/row/{link.get('name')}/detach"
        uri = link.findtext("collision/geometry/mesh/uri")
        hull = trimesh.load(sdf[0].parent / uri)
        assert hull.is_watertight
        mass = float(link.findtext("inertial/mass"))
        assert mass == pytest.approx(500.0 * hull.volume, rel=1e-3)
        centre = np.array(link.findtext("inertial/pose").split(), float)[:3]
        np.testing.assert_allclose(centre, hull.center_mass, atol=1e-5)


# --- all formats --------------------------------------------------------------------------------------------


def test_coarse_plants_are_joined_and_keep_all_numbers(small):
    mesh = small.scene.mesh
    far = tuple(
        item.numbered(item.plant, item.parent, 0 if item.plant == 1 else -1) for item in mesh.instances
    )
    contents = scene_contents(assemble_scene(replace(mesh, instances=far)))
    numbers = [entry.get("instances") or [entry["instance"]] for entry in contents.nodes.extras]
    assert sorted(itertools.chain(*numbers)) == list(range(1, len(far) + 1))
    joined = [index for index, entry in enumerate(contents.nodes.extras) if "instances" in entry]
    assert 1 < len(joined) <= 7
    for index in joined:
        originals = np.array(contents.nodes.extras[index]["instances"]) - 1
        assert {far[original].class_id for original in originals} == {contents.mesh.instances[index].class_id}
        faces = np.isin(mesh.face_instance, originals)
        np.testing.assert_array_equal(contents.mesh.face_instance[faces], index)


def test_a_recipe_is_exported_as_its_scene_is(small, glb, tmp_path, rows):
    with rows_from(rows):
        result = ps.export_scene(small.recipe, tmp_path / "new" / "row.glb", FRAME)
    assert result[0].read_bytes() == glb[0].read_bytes()
    content = json.loads(result[1].read_text(encoding="utf-8"))
    assert (content["recipe"], content["frame"]) == ("barth2018", FRAME)
    # Files of an earlier call are replaced.
    content["frame"] = 0
    result[1].write_text("old")
    ps.export_scene(small.scene, result[0])
    assert json.loads(result[1].read_text(encoding="utf-8"))["camera"] is None


def test_invalid_arguments_write_nothing(small, tmp_path):
    for name in ("row.obj", "row", ".glb"):
        with pytest.raises(InputError, match=r"must end in \.glb, .* or \.sdf"):
            ps.export_scene(small.scene, tmp_path / name)
    with pytest.raises(ArgumentError, match="frame: applies to recipes"):
        ps.export_scene(small.scene, tmp_path / "row.glb", 3)
    with pytest.raises(ArgumentError, match="camera: applies to scenes"):
        ps.export_scene(small.recipe, tmp_path / "row.glb", camera=small.camera)
    with pytest.raises(ArgumentError, match="frame 1000000 does not exist"):
        ps.export_scene(small.recipe, tmp_path / "row.glb", 1_000_000)
    moved = replace(small.scene, mesh=small.scene.mesh.moved(np.eye(3), np.ones(3)))
    with pytest.raises(ArgumentError, match="has moved or changed triangles"):
        ps.export_scene(moved, tmp_path / "row.glb")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "row").mkdir()
    (tmp_path / "row" / "mine.txt").touch()
    with pytest.raises(OutputError, match="choose an empty or a new folder"):
        ps.export_scene(small.scene, tmp_path / "row.sdf")
    assert [path.name for path in (tmp_path / "row").iterdir()] == ["mine.txt"]


def test_usd_needs_its_library(small, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr.UsdSemantics", None)
    with pytest.raises(SetupError, match=r"needs pxr, .*pip install 'pepperscene\[usd\]'"):
        ps.export_scene(small.scene, tmp_path / "row.usd")
    assert list(tmp_path.iterdir()) == []


def test_glb_has_its_images_inside(glb):
    content = glb[0].read_bytes()
    tree = glb_json(glb[0])
    start = 28 + int.from_bytes(content[12:16], "little")
    assert tree["images"]
    for image in tree["images"]:
        view = tree["bufferViews"][image["bufferView"]]
        first = start + view.get("byteOffset", 0)
        with Image.open(BytesIO(content[first : first + view["byteLength"]])) as picture:
            assert picture.format == "PNG"


@pytest.mark.long
def test_all_fruit_of_a_row_are_found_by_name_and_number(tmp_path, rows):
    """196 fruit of 13 plants, one by one, and rays of the frame's own camera."""
    recipe = ps.load_recipe("barth2018", {"camera.width": 320, "camera.height": 240})
    with rows_from(rows):
        frames = FrameRenderer(recipe, culled=False)
        spec = recipe.plan.frame(FRAME)
        frame, scene = frames.render(spec, ["depth_z"]), frames.current_scene
        path, _ = ps.export_scene(recipe, tmp_path / "row.glb", FRAME)
    nodes = glb_nodes(path)
    names = {node.extras["instance"]: name for name, node in nodes.items() if "ripeness" in node.extras}
    fruit = scene.skeleton.of_form("fruit")
    assert sorted(names) == [index + 1 for index in fruit]
    assert len(fruit) > 100
    for index in fruit:
        node, organ = nodes[names[index + 1]], scene.skeleton.organ(index)
        item = scene.mesh.instances[index]
        assert names[index + 1].startswith(f"plant_{item.plant}_fruit_")
        assert names[index + 1].endswith(f"_node_{item.phytomer}")
        np.testing.assert_allclose(node.pose[:3, 3], organ.curve[0], atol=1e-5)
        assert node.extras["ripeness"] == pytest.approx(organ.measures["ripeness"], abs=1e-6)
        cut = np.array(node.extras["cut_point_m"])
        stalk = scene.skeleton.organ(node.extras["stalk"] - 1)
        # On the curve of the stalk, which is straight between its points to a few millimetres.
        steps = np.linspace(stalk.curve[:-1], stalk.curve[1:], 50).reshape(-1, 3)
        assert np.linalg.norm(steps - cut, axis=1).min() < 5e-3
    depth, camera = frame["depth_z"], frames.camera(spec, traced=False)
    hit = np.argwhere(np.isfinite(depth) & (depth > 0))
    pixels = hit[np.random.default_rng(3).choice(len(hit), RAYS, replace=False)]
    directions = camera.pixel_directions()[pixels[:, 0], pixels[:, 1]]
    found = cast_rays(nodes, camera.pose, directions[:, :2] / directions[:, 2:])
    np.testing.assert_allclose(found, depth[pixels[:, 0], pixels[:, 1]], atol=1e-3)
