"""Viewpoint planning: where cameras can be, tables of what they see, and planners to compare with."""

from pepperscene.building.viewpoints.planners import PlannerComparison, compare_planners
from pepperscene.building.viewpoints.workspace import (
    BoxWorkspace,
    FunctionWorkspace,
    ReachTest,
    SphereWorkspace,
    Workspace,
    lattice_poses,
    random_poses,
)

__all__ = [
    "BoxWorkspace",
    "FunctionWorkspace",
    "PlannerComparison",
    "ReachTest",
    "SphereWorkspace",
    "Workspace",
    "compare_planners",
    "lattice_poses",
    "random_poses",
]
