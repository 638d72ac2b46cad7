"""USD of a scene, as Isaac Sim and other programs read it, written through usd-core.

Formats: OpenUSD's schemas UsdGeom, UsdShade, UsdLux, UsdPhysics and UsdSemantics (openusd.org). Versions of
Isaac Sim before 5 read the older SemanticsAPI instead of UsdSemantics, so labels are in both.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.image.colorimetry import srgb_decode
from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset.store.images import png_bytes
from pepperscene.export.simulators.contents import (
    BREAK_FORCE_N,
    BREAK_TORQUE_N_M,
    HarvestBody,
    Pose,
    SceneContents,
    fruit_hull,
    fruit_mass_kg,
    is_rigid,
)
from pepperscene.geometry.glb import roughness
from pepperscene.geometry.mesh import PIGMENTS
from pepperscene.geometry.natural_colours import linear_colours
from pepperscene.geometry.organ_parts import OrganPart, organ_parts
from pepperscene.libraries import import_library

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.scene import Sky
    from pepperscene.spectra import Spectrum

_ROOT: Final = "/World"
_PLANTS: Final = f"{_ROOT}/plant_"
_OBJECTS: Final = f"{_ROOT}/objects"
_LOOKS: Final = f"{_ROOT}/looks"
_TENTHS: Final = 10.0  # focal lengths and apertures are in tenths of the stage's unit
_LUMINANCE: Final = np.array([0.2126, 0.7152, 0.0722])  # of linear sRGB, IEC 61966-2-1
_FAR_M: Final = 100.0  # chosen: far clipping plane
_NEAR_M: Final = 0.01  # chosen: near clipping plane
_PROPERTY: Final = "userProperties:"
"""Namespace of attributes that Blender reads as custom properties and Isaac Sim shows."""


def usd_files(contents: SceneContents, name: str) -> dict[str, bytes]:
    """Encode a scene as a USD file of this name, and its images; `.usda` is text, other suffixes are binary.

    Returns:
        Content by file name, that of `name` first.

    Raises:
        SetupError: the library usd-core is not installed.
    """
    images = {
        f"{Path(name).stem}_{key}.png": png_bytes(image) for key, image in contents.colours.images.items()
    }
    stage = _Stage(contents, dict(zip(contents.colours.images, images, strict=True)))
    stage.write()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / Path(name).with_stem("scene").name
        stage.stage.GetRootLayer().Export(str(path))
        return {name: path.read_bytes(), **images}


@dataclass(eq=False)
class _Stage:
    """A stage that is being filled."""

    contents: SceneContents
    images: Mapping[str, str]  # file name of each image of the colours
    paths: dict[int, str] = field(default_factory=dict)  # of the prims of nodes

    def __post_init__(self) -> None:
        self.pxr = import_library("pxr", "usd")
        # Modules are attributes of the package once they are imported.
        from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdLux, UsdPhysics, UsdSemantics, UsdShade, Vt  # noqa: F401

        self.stage = self.pxr.Usd.Stage.CreateInMemory()

    def write(self) -> None:
        pxr, contents = self.pxr, self.contents
        pxr.UsdGeom.SetStageMetersPerUnit(self.stage, 1.0)
        pxr.UsdGeom.SetStageUpAxis(self.stage, pxr.UsdGeom.Tokens.z)
        pxr.UsdPhysics.SetStageKilogramsPerUnit(self.stage, 1.0)
        self.stage.SetDefaultPrim(self._xform(_ROOT))
        pxr.UsdPhysics.Scene.Define(self.stage, f"{_ROOT}/physics")
        self._xform(_OBJECTS)
        for number, pose in contents.nodes.plants.items():
            prim = self._xform(f"{_PLANTS}{number}", pose)
            self._set(prim, "plant", number)
        # Bodies first: their organs are inside.
        bases: dict[int, tuple[str, Pose]] = {}
        for body in contents.bodies:
            path = self._body(body)
            bases |= dict.fromkeys(body.members, (path, body.pose))
        for part in organ_parts(contents.mesh, contents.nodes.names):
            plant = contents.mesh.instances[part.index].plant
            default = _OBJECTS, np.eye(4)
            if plant in contents.nodes.plants:
                default = f"{_PLANTS}{plant}", contents.nodes.plants[plant]
            self._organ(part, *bases.get(part.index, default))
        for body in contents.bodies:
            self._joint(body)
        self._lights(contents.sky)
        if contents.camera is not None:
            self._camera(contents.camera)

    def _xform(self, path: str, pose: Pose | None = None) -> Any:
        xform = self.pxr.UsdGeom.Xform.Define(self.stage, path)
        if pose is not None:
            self._place(xform, pose)
        return xform.GetPrim()

    def _place(self, prim: Any, pose: Pose) -> None:
        """Give a prim a pose in the axes of its parent."""
        prim.AddTranslateOp().Set(self.pxr.Gf.Vec3d(*map(float, pose[:3, 3])))
        prim.AddOrientOp(self.pxr.UsdGeom.XformOp.PrecisionDouble).Set(self._quaternion(pose))

    def _quaternion(self, pose: Pose) -> Any:
        matrix = self.pxr.Gf.Matrix3d(*map(float, pose[:3, :3].T.ravel()))
        return matrix.ExtractRotation().GetQuat()

    def _label(self, prim: Any, labels: Mapping[str, str]) -> None:
        """Semantic labels by taxonomy; the older schema has that of the class."""
        types = self.pxr.Sdf.ValueTypeNames
        for taxonomy, label in labels.items():
            api = self.pxr.UsdSemantics.LabelsAPI.Apply(prim, taxonomy)
            api.CreateLabelsAttr([label])
        prim.AddAppliedSchema("SemanticsAPI:Semantics")
        for name, value in (("semanticType", "class"), ("semanticData", labels["class"])):
            prim.CreateAttribute(f"semantic:Semantics:params:{name}", types.String, False).Set(value)

    def _set(self, prim: Any, name: str, value: Any) -> None:
        """Set an attribute of the project; lists are points or numbers, None and others are left out."""
        types = self.pxr.Sdf.ValueTypeNames
        if isinstance(value, str):
            kind = types.String
        elif isinstance(value, int):
            kind = types.Int
        elif isinstance(value, float):
            kind = types.Double
        elif isinstance(value, list) and value and isinstance(value[0], int):
            kind = types.IntArray
        elif isinstance(value, list):
            kind, value = types.Double3, self.pxr.Gf.Vec3d(*value)
        else:
            return
        prim.CreateAttribute(_PROPERTY + name, kind, True).Set(value)

    def _body(self, body: HarvestBody) -> str:
        """The prim of what falls when a fruit is cut, without its organs."""
        pxr, name = self.pxr, self.contents.nodes.names[body.fruit]
        path = f"{_PLANTS}{body.plant}/{pxr.Tf.MakeValidIdentifier('body_' + name)}"
        prim = self._xform(path, np.linalg.inv(self.contents.nodes.plants[body.plant]) @ body.pose)
        pxr.UsdPhysics.RigidBodyAPI.Apply(prim)
        mass = fruit_mass_kg(fruit_hull(self.contents, body))
        pxr.UsdPhysics.MassAPI.Apply(prim).CreateMassAttr(mass)
        return path

    def _joint(self, body: HarvestBody) -> None:
        """The joint at the cut, between the plant, which does not move, and the body."""
        pxr, plant = self.pxr, f"{_PLANTS}{body.plant}"
        path = self.paths[body.fruit].rpartition("/")[0]
        joint = pxr.UsdPhysics.FixedJoint.Define(self.stage, f"{path}_joint")
        pose = np.linalg.inv(self.contents.nodes.plants[body.plant]) @ body.pose
        joint.CreateBody0Rel().SetTargets([plant])
        joint.CreateBody1Rel().SetTargets([path])
        joint.CreateLocalPos0Attr(pxr.Gf.Vec3f(*map(float, pose[:3, 3])))
        joint.CreateLocalRot0Attr(pxr.Gf.Quatf(self._quaternion(pose)))
        joint.CreateLocalPos1Attr(pxr.Gf.Vec3f(0.0))
        joint.CreateLocalRot1Attr(pxr.Gf.Quatf(1.0))
        joint.CreateBreakForceAttr(BREAK_FORCE_N)
        joint.CreateBreakTorqueAttr(BREAK_TORQUE_N_M)

    def _organ(self, part: OrganPart, parent: str, base: Pose) -> None:
        """A part of an organ as a mesh below another prim with a pose."""
        pxr, contents = self.pxr, self.contents
        pose, entry = contents.nodes.pose(part.index), contents.nodes.extras[part.index]
        path = f"{parent}/{pxr.Tf.MakeValidIdentifier(part.name)}"
        self.paths.setdefault(part.index, path)
        mesh = pxr.UsdGeom.Mesh.Define(self.stage, path)
        self._place(mesh, np.linalg.inv(base) @ pose)
        points, normals = part.local(contents.mesh, pose)
        mesh.CreatePointsAttr(self._vectors(points))
        mesh.CreateNormalsAttr(self._vectors(normals))
        mesh.SetNormalsInterpolation(pxr.UsdGeom.Tokens.vertex)
        mesh.CreateFaceVertexCountsAttr(pxr.Vt.IntArray.FromNumpy(np.full(len(part.faces), 3, np.int32)))
        mesh.CreateFaceVertexIndicesAttr(pxr.Vt.IntArray.FromNumpy(part.faces.astype(np.int32).ravel()))
        mesh.CreateExtentAttr(self._vectors(np.stack([points.min(axis=0), points.max(axis=0)])))
        mesh.CreateSubdivisionSchemeAttr(pxr.UsdGeom.Tokens.none)
        mesh.CreateDoubleSidedAttr(True)
        prim = mesh.GetPrim()
        self._look(mesh, part)
        labels = {"class": entry["class"], "kind": entry["kind"]}
        # Joined organs of coarse plants have no number of their own.
        self._label(prim, labels | ({"instance": str(entry["instance"])} if "instance" in entry else {}))
        for name, value in {**entry, "surface": part.surface}.items():
            self._set(prim, name, value)
        self._collide(prim, part)

    def _vectors(self, points: NDArray[np.floating[Any]]) -> Any:
        return self.pxr.Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(points, np.float32))

    def _collide(self, prim: Any, part: OrganPart) -> None:
        """Fruit collides as its convex hull, what does not move as its triangles, leaves and stalks not."""
        item, tokens = self.contents.mesh.instances[part.index], self.pxr.UsdPhysics.Tokens
        is_fruit = part.index in self.contents.truths
        if not is_fruit and not is_rigid(item):
            return
        self.pxr.UsdPhysics.CollisionAPI.Apply(prim)
        api = self.pxr.UsdPhysics.MeshCollisionAPI.Apply(prim)
        api.CreateApproximationAttr(tokens.convexHull if is_fruit else tokens.none)

    def _look(self, mesh: Any, part: OrganPart) -> None:
        """Bind the material of a part: an image, colours of a scan, or the colour of its class."""
        pxr, contents = self.pxr, self.contents
        colours, types = contents.colours, pxr.Sdf.ValueTypeNames
        image = int(colours.face_image[part.rows[0]])
        api = pxr.UsdGeom.PrimvarsAPI(mesh)
        scanned = contents.mesh.colours_of(part.vertices)
        if image >= 0:
            name = list(colours.images)[image]
            st = api.CreatePrimvar("st", types.TexCoord2fArray, pxr.UsdGeom.Tokens.vertex)
            st.Set(pxr.Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(colours.uv[part.vertices])))
            source = ("st", self.images[name])
        elif scanned is not None and scanned[0, 0] != PIGMENTS:
            name, source = f"{part.surface}_scan", ("displayColor", "")
            mesh.CreateDisplayColorPrimvar(pxr.UsdGeom.Tokens.vertex).Set(self._vectors(scanned))
        else:
            organ_class = contents.mesh.instances[part.index].organ_class
            name, source = f"class_{organ_class.name.lower()}", ("", "")
        material = self._material(name, part, *source)
        pxr.UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)

    def _material(self, name: str, part: OrganPart, primvar: str, file: str) -> Any:
        """A material whose colour is an image at a primvar, the primvar itself, or that of a class."""
        pxr, types = self.pxr, self.pxr.Sdf.ValueTypeNames
        path = f"{_LOOKS}/{pxr.Tf.MakeValidIdentifier(name)}"
        if self.stage.GetPrimAtPath(path):
            return pxr.UsdShade.Material.Get(self.stage, path)
        material = pxr.UsdShade.Material.Define(self.stage, path)
        shader = self._shader(f"{path}/surface", "UsdPreviewSurface")
        shader.CreateInput("roughness", types.Float).Set(roughness(part.surface))
        shader.CreateInput("metallic", types.Float).Set(0.0)
        colour = shader.CreateInput("diffuseColor", types.Color3f)
        output = shader.CreateOutput("surface", types.Token)
        material.CreateSurfaceOutput().ConnectToSource(output)
        if not primvar:
            organ_class: OrganClass = self.contents.mesh.instances[part.index].organ_class
            linear = srgb_decode(np.array(CLASS_COLOURS[organ_class]) / 255.0)
            colour.Set(pxr.Gf.Vec3f(*map(float, linear)))
            return material
        reader = self._shader(f"{path}/{primvar}", f"UsdPrimvarReader_float{2 if file else 3}")
        reader.CreateInput("varname", types.String).Set(primvar)
        result = reader.CreateOutput("result", types.Float2 if file else types.Float3)
        if file:
            texture = self._shader(f"{path}/image", "UsdUVTexture")
            texture.CreateInput("file", types.Asset).Set(f"./{file}")
            texture.CreateInput("sourceColorSpace", types.Token).Set("sRGB")
            texture.CreateInput("wrapS", types.Token).Set("clamp")
            texture.CreateInput("wrapT", types.Token).Set("clamp")
            texture.CreateInput("st", types.Float2).ConnectToSource(result)
            result = texture.CreateOutput("rgb", types.Float3)
        colour.ConnectToSource(result)
        return material

    def _shader(self, path: str, identifier: str) -> Any:
        shader = self.pxr.UsdShade.Shader.Define(self.stage, path)
        shader.CreateIdAttr(identifier)
        return shader

    def _lights(self, sky: Sky | None) -> None:
        """A dome with the mean light of the sky, cd m-2, and the sun, lux on a plane that faces it."""
        from pepperscene.spectra import Spectrum

        if sky is None:
            return
        pxr = self.pxr
        level = Spectrum(sky.radiance.wavelength_nm, sky.received() @ sky.radiance.values)
        dome = pxr.UsdLux.DomeLight.Define(self.stage, f"{_ROOT}/sky")
        self._shine(dome, level, 1.0 / np.pi)
        if sky.sun is None:
            return
        sun = pxr.UsdLux.DistantLight.Define(self.stage, f"{_ROOT}/sun")
        self._shine(sun, sky.sun.irradiance, 1.0)
        sun.CreateAngleAttr(float(np.degrees(2.0 * sky.sun.angular_radius)))
        sun.CreateNormalizeAttr(True)
        # The light shines along its -z axis.
        towards = pxr.Gf.Vec3d(*map(float, sky.sun.direction))
        turn = pxr.Gf.Rotation(pxr.Gf.Vec3d(0.0, 0.0, 1.0), towards).GetQuat()
        sun.AddOrientOp(pxr.UsdGeom.XformOp.PrecisionDouble).Set(turn)

    def _shine(self, light: Any, spectrum: Spectrum, factor: float) -> None:
        """Intensity of a light, and its colour of luminance 1."""
        from pepperscene.spectra import illuminance

        nm = np.arange(380.0, 781.0, 5.0)
        linear = np.maximum(linear_colours(spectrum.at(nm)[None], nm, np.ones(len(nm)))[0], 0.0)
        light.CreateIntensityAttr(float(illuminance(spectrum)) * factor)
        colour = linear / max(float(linear @ _LUMINANCE), 1e-12)
        light.CreateColorAttr(self.pxr.Gf.Vec3f(*map(float, colour)))

    def _camera(self, camera: Camera) -> None:
        """The camera of the frame as a pinhole; its JSON has the distortion."""
        pxr, matrix = self.pxr, camera.intrinsics
        prim = pxr.UsdGeom.Camera.Define(self.stage, f"{_ROOT}/camera")
        # A camera of USD looks along its -z with y up.
        self._place(prim, camera.pose @ np.diag([1.0, -1.0, -1.0, 1.0]))
        focal = _TENTHS * camera.lens.focal_length_m
        (fx, fy), (cx, cy) = matrix[[0, 1], [0, 1]], matrix[:2, 2]
        prim.CreateFocalLengthAttr(focal)
        prim.CreateHorizontalApertureAttr(float(focal * camera.width / fx))
        prim.CreateVerticalApertureAttr(float(focal * camera.height / fy))
        prim.CreateHorizontalApertureOffsetAttr(float(focal * (0.5 * camera.width - cx) / fx))
        prim.CreateVerticalApertureOffsetAttr(float(focal * (cy - 0.5 * camera.height) / fy))
        prim.CreateClippingRangeAttr(pxr.Gf.Vec2f(_NEAR_M, _FAR_M))
        for name, value in (("width", camera.width), ("height", camera.height)):
            self._set(prim.GetPrim(), name, value)
        if camera.focus_m is not None:
            prim.CreateFocusDistanceAttr(float(camera.focus_m))
            prim.CreateFStopAttr(float(camera.lens.f_number))
