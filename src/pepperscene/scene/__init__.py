"""Scenes as plain data: plant rows, greenhouse, sky and cover, and the culling of invisible geometry."""

from pepperscene.scene.charts import CalibrationChart
from pepperscene.scene.cover import Cover, load_cover
from pepperscene.scene.culling import (
    LightReach,
    ViewFrustums,
    combine_reaches,
    cull_mesh,
    light_reach,
    view_frustums,
)
from pepperscene.scene.far_rows import FarRow, coarsen_plant, draw_far_rows, far_row_meshes
from pepperscene.scene.floor import ground_area, leaf_area_index
from pepperscene.scene.greenhouse import (
    Greenhouse,
    Posture,
    draw_posture,
    greenhouse_mesh,
    jittered_positions,
)
from pepperscene.scene.placement import Scene, Skeleton, assemble_scene, build_skeleton
from pepperscene.scene.row import DoubleRow, Twine, add_twine, double_row, place_plants, rotation_about_z
from pepperscene.scene.sky import Daylight, Sky, Sun, partly_cloudy_sky, uniform_sky
from pepperscene.scene.stand import Stand, stand_meshes, turned_parts, turned_sky

__all__ = [
    "CalibrationChart",
    "Cover",
    "Daylight",
    "DoubleRow",
    "FarRow",
    "Greenhouse",
    "LightReach",
    "Posture",
    "Scene",
    "Skeleton",
    "Sky",
    "Stand",
    "Sun",
    "Twine",
    "ViewFrustums",
    "add_twine",
    "assemble_scene",
    "build_skeleton",
    "coarsen_plant",
    "combine_reaches",
    "cull_mesh",
    "double_row",
    "draw_far_rows",
    "draw_posture",
    "far_row_meshes",
    "greenhouse_mesh",
    "ground_area",
    "jittered_positions",
    "leaf_area_index",
    "light_reach",
    "load_cover",
    "partly_cloudy_sky",
    "place_plants",
    "rotation_about_z",
    "stand_meshes",
    "turned_parts",
    "turned_sky",
    "uniform_sky",
    "view_frustums",
]
