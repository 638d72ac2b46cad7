"""Build the scene that `cycles_scene` has exported, inside Blender.

Used by `blender_main.py` only; like that script it does not import pepperscene.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

_CLIP_M: Final = (1e-4, 1e3)  # chosen: leaves may touch the lens
_CONSTANT: Final = 1e-6  # relative variation below which a sky is a single colour


def build(bpy: Any, arrays: Any, facts: dict[str, Any]) -> None:
    """Build mesh, camera and lights in Blender's empty scene.

    Args:
        bpy: the module.
        arrays: of a `CyclesScene`.
        facts: of the same.
    """
    _add_mesh(bpy, arrays, facts["materials"])
    _add_sky(bpy, arrays.get("sky"))
    _add_camera(bpy, facts["camera"])
    if "flash" in facts:
        _add_flash(bpy, facts["flash"])
    if "sun" in facts:
        _add_sun(bpy, facts["sun"])


# --- surfaces -----------------------------------------------------------------------------------------------


def _add_mesh(bpy: Any, arrays: Any, materials: list[dict[str, Any]]) -> None:
    """Add all triangles as one mesh: many objects would cost Cycles a second more."""
    vertices, faces = arrays["vertices"], arrays["faces"]
    mesh = bpy.data.meshes.new("all")
    mesh.vertices.add(len(vertices))
    mesh.loops.add(3 * len(faces))
    mesh.polygons.add(len(faces))
    mesh.vertices.foreach_set("co", vertices.ravel())
    mesh.loops.foreach_set("vertex_index", faces.ravel())
    mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * len(faces), 3, dtype=np.int32))
    mesh.polygons.foreach_set("material_index", arrays["face_material"])
    mesh.update(calc_edges=True)
    translucent = any(material["translucent"] for material in materials)
    two_sided = any(material["two_sided"] for material in materials)
    attributes = {"custom_normal": "normals", "front": "front"}
    attributes |= {"back": "back"} if two_sided else {}
    attributes |= {"through": "through"} if translucent else {}
    for name, array in attributes.items():
        attribute = mesh.attributes.new(name, "FLOAT_VECTOR", "POINT")
        attribute.data.foreach_set("vector", arrays[array].ravel())
    mesh.update()
    for number, material in enumerate(materials):
        mesh.materials.append(_material(bpy, f"cuticle {number}", material))
    body = bpy.data.objects.new("all", mesh)
    body.cycles.shadow_terminator_offset = body.cycles.shadow_terminator_geometry_offset = 0.0
    bpy.context.scene.collection.objects.link(body)


def _material(bpy: Any, name: str, facts: dict[str, Any]) -> Any:
    """A diffuse, translucent body under a rough dielectric; colours come from the vertices."""
    material = bpy.data.materials.new(name)
    tree = _Tree(material)
    side = tree.add("ShaderNodeNewGeometry").outputs["Backfacing"]
    front = tree.add("ShaderNodeAttribute", attribute_name="front").outputs["Vector"]
    colour = front
    if facts["two_sided"]:
        back = tree.add("ShaderNodeAttribute", attribute_name="back").outputs["Vector"]
        colour = tree.mix(side, front, back)
    shader = _coated(tree, side, colour, facts) if facts["ior"] > 1.0 else _matte(tree, colour)
    if facts["translucent"]:
        shader = tree.join("ShaderNodeAddShader", shader, _translucent(tree, side, facts))
    tree.link(shader, tree.output.inputs["Surface"])
    return material


def _matte(tree: _Tree, colour: Any) -> Any:
    diffuse = tree.add("ShaderNodeBsdfDiffuse")
    tree.link(colour, diffuse.inputs["Color"])
    return diffuse.outputs[0]


def _coated(tree: _Tree, side: Any, colour: Any, facts: dict[str, Any]) -> Any:
    """Principled BSDF: what its dielectric does not reflect reaches the diffuse body, as in our surfaces."""
    principled = tree.add("ShaderNodeBsdfPrincipled", distribution="GGX")
    principled.inputs["IOR"].default_value = facts["ior"]
    front, back = (math.sqrt(alpha) for alpha in facts["alpha"])  # Blender's roughness is the root of alpha
    if front == back:
        principled.inputs["Roughness"].default_value = front
    else:
        tree.link(tree.affine(side, back - front, front), principled.inputs["Roughness"])
    tree.link(colour, principled.inputs["Base Color"])
    return principled.outputs[0]


def _translucent(tree: _Tree, side: Any, facts: dict[str, Any]) -> Any:
    """Light that enters through the cuticle and is transmitted by the body."""
    scale = facts["exit_fraction"][0]
    if facts["exit_fraction"][0] != facts["exit_fraction"][1]:
        scale = tree.affine(
            side, facts["exit_fraction"][1] - facts["exit_fraction"][0], facts["exit_fraction"][0]
        )
    if facts["transmittance"]:
        geometry = tree.add("ShaderNodeNewGeometry")
        cosine = tree.vector("DOT_PRODUCT", geometry.outputs["Normal"], geometry.outputs["Incoming"], "Value")
        places = np.linspace(0.0, 1.0, len(facts["transmittance"])).tolist()
        scale = tree.math("MULTIPLY", tree.ramp(cosine, places, facts["transmittance"]), scale)
    colour = tree.add("ShaderNodeAttribute", attribute_name="through").outputs["Vector"]
    translucent = tree.add("ShaderNodeBsdfTranslucent")
    tree.link(tree.vector("SCALE", colour, scale, "Vector"), translucent.inputs["Color"])
    return translucent.outputs[0]


class _Tree:
    """A shader node tree."""

    def __init__(self, owner: Any) -> None:
        owner.use_nodes = True
        self.nodes, self._links = owner.node_tree.nodes, owner.node_tree.links
        kinds = {"LIGHT": "ShaderNodeOutputLight", "WORLD": "ShaderNodeOutputWorld"}
        self.nodes.clear()
        self.output = self.add(kinds.get(owner.id_type, "ShaderNodeOutputMaterial"))

    def add(self, kind: str, **values: Any) -> Any:
        node = self.nodes.new(kind)
        for name, value in values.items():
            setattr(node, name, value)
        return node

    def link(self, value: Any, socket: Any) -> None:
        """Set a socket to a number, or connect it to another node's output."""
        if isinstance(value, int | float):
            socket.default_value = value
        else:
            self._links.new(value, socket)

    def join(self, kind: str, first: Any, second: Any) -> Any:
        node = self.add(kind)
        self.link(first, node.inputs[0])
        self.link(second, node.inputs[1])
        return node.outputs[0]

    def math(self, operation: str, first: Any, second: Any = 0.0) -> Any:
        node = self.add("ShaderNodeMath", operation=operation)
        self.link(first, node.inputs[0])
        self.link(second, node.inputs[1])
        return node.outputs[0]

    def affine(self, value: Any, slope: float, start: float) -> Any:
        node = self.add("ShaderNodeMath", operation="MULTIPLY_ADD")
        self.link(value, node.inputs[0])
        node.inputs[1].default_value, node.inputs[2].default_value = slope, start
        return node.outputs[0]

    def vector(self, operation: str, first: Any, second: Any, output: str) -> Any:
        node = self.add("ShaderNodeVectorMath", operation=operation)
        self.link(first, node.inputs[0])
        self.link(second, node.inputs["Scale"] if operation == "SCALE" else node.inputs[1])
        return node.outputs[output]

    def mix(self, factor: Any, first: Any, second: Any) -> Any:
        node = self.add("ShaderNodeMix", data_type="VECTOR", factor_mode="UNIFORM")
        for socket in node.inputs:
            if socket.identifier in ("Factor_Float", "A_Vector", "B_Vector"):
                self.link({"F": factor, "A": first, "B": second}[socket.identifier[0]], socket)
        return next(socket for socket in node.outputs if socket.identifier == "Result_Vector")

    def ramp(self, value: Any, places: list[float], levels: list[float]) -> Any:
        """Piecewise linear function over [0, 1]; Cycles tabulates it in 256 steps."""
        node = self.add("ShaderNodeValToRGB")
        elements = node.color_ramp.elements
        for number, (place, level) in enumerate(zip(places, levels, strict=True)):
            element = elements[number] if number < 2 else elements.new(place)
            element.position, element.color = place, (level, level, level, 1.0)
        self.link(value, node.inputs[0])
        return node.outputs["Color"]


# --- camera and lights --------------------------------------------------------------------------------------


def _add_camera(bpy: Any, facts: dict[str, Any]) -> None:
    data = bpy.data.cameras.new("camera")
    data.sensor_fit = "HORIZONTAL"
    data.lens, data.sensor_width = facts["lens_mm"], facts["sensor_width_mm"]
    data.shift_x, data.shift_y = facts["shift_x"], facts["shift_y"]
    data.clip_start, data.clip_end = _CLIP_M
    if facts["focus_m"] is not None:
        data.dof.use_dof = True
        data.dof.focus_distance, data.dof.aperture_fstop = facts["focus_m"], facts["f_number"]
    bpy.context.scene.camera = _add_object(bpy, "camera", data, facts["matrix_world"])


def _add_flash(bpy: Any, facts: dict[str, Any]) -> None:
    """A rectangle whose radiance is the beam's intensity over the projected area."""
    light = bpy.data.lights.new("flash", "AREA")
    light.shape = "RECTANGLE"
    light.size, light.size_y = facts["sides_m"]
    light.energy = math.pi  # for a Lambertian emitter, 1 W/sr on the axis
    tree = _Tree(light)
    geometry = tree.add("ShaderNodeNewGeometry")
    cosine = tree.vector("DOT_PRODUCT", geometry.outputs["Normal"], geometry.outputs["Incoming"], "Value")
    cosine = tree.math("MINIMUM", tree.math("MAXIMUM", cosine, 1e-3), 1.0)
    last = facts["angle_rad"][-1]
    places = [angle / last for angle in facts["angle_rad"]]
    relative = tree.ramp(
        tree.math("DIVIDE", tree.math("ARCCOSINE", cosine), last), places, facts["relative_intensity"]
    )
    inside = tree.math("LESS_THAN", tree.math("ARCCOSINE", cosine), last)
    emission = tree.add("ShaderNodeEmission")
    emission.inputs["Color"].default_value = (*facts["intensity"], 1.0)
    strength = tree.math("MULTIPLY", tree.math("DIVIDE", relative, cosine), inside)
    tree.link(strength, emission.inputs["Strength"])
    tree.link(emission.outputs[0], tree.output.inputs["Surface"])
    lamp = _add_object(bpy, "flash", light, facts["matrix_world"])
    lamp.visible_camera = False


def _add_sun(bpy: Any, facts: dict[str, Any]) -> None:
    from mathutils import Vector  # type: ignore[import-not-found]

    light = bpy.data.lights.new("sun", "SUN")
    light.angle = 2.0 * facts["angular_radius"]
    light.energy = max(facts["irradiance"])
    light.color = [channel / light.energy for channel in facts["irradiance"]]
    rotation = Vector(facts["direction"]).to_track_quat("Z", "Y").to_matrix().to_4x4()
    _add_object(bpy, "sun", light, [list(row) for row in rotation])


def _add_sky(bpy: Any, sky: Any) -> None:
    """Add the sky as an equirectangular image; as a colour if it is uniform; black without a sky."""
    world = bpy.data.worlds.new("sky")
    bpy.context.scene.world = world
    tree = _Tree(world)
    background = tree.add("ShaderNodeBackground")
    tree.link(background.outputs[0], tree.output.inputs["Surface"])
    if sky is None or not np.any(sky):
        background.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
        return
    if np.ptp(sky, axis=(0, 1)).max() <= _CONSTANT * sky.max():
        background.inputs["Color"].default_value = (*sky[0, 0].tolist(), 1.0)
        return
    # Blender's columns run clockwise from -x, its rows start at the nadir.
    wide = sky if sky.shape[1] % 2 == 0 else np.repeat(sky, 2, axis=1)
    columns = wide.shape[1]
    flipped = wide[::-1, (columns // 2 - 1 - np.arange(columns)) % columns]
    image = bpy.data.images.new("sky", columns, len(wide), float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    pixels = np.concatenate([flipped, np.ones((*flipped.shape[:2], 1), np.float32)], axis=-1)
    image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
    image.update()
    texture = tree.add("ShaderNodeTexEnvironment", image=image)
    tree.link(texture.outputs["Color"], background.inputs["Color"])


def _add_object(bpy: Any, name: str, data: Any, matrix: list[list[float]]) -> Any:
    from mathutils import Matrix

    new_object = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(new_object)
    new_object.matrix_world = Matrix(matrix)
    return new_object
