"""Benchmark tasks for other people's methods: data by a recipe, a measure, and baselines."""

from pepperscene.learning.tasks.depth_task import evaluate_depth
from pepperscene.learning.tasks.result import Score, TaskResult
from pepperscene.learning.tasks.sensor_task import evaluate_sensors
from pepperscene.learning.tasks.trait_task import evaluate_trait
from pepperscene.learning.tasks.view_planners import Planner, PlanningState
from pepperscene.learning.tasks.view_scenes import ViewTask
from pepperscene.learning.tasks.view_task import evaluate_planners

__all__ = [
    "Planner",
    "PlanningState",
    "Score",
    "TaskResult",
    "ViewTask",
    "evaluate_depth",
    "evaluate_planners",
    "evaluate_sensors",
    "evaluate_trait",
]
