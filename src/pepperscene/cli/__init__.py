"""The command line: one module for each group of commands.

Exit codes: 0 success, 1 a data set has faults, 2 an error that the user can fix (one line says what), 128
plus the number of the signal that interrupted the command.
"""

from pepperscene.cli import (
    building,
    datasets,
    learning,
    machine,
    tasks,
    tuning,
    viewpoints,
)
from pepperscene.cli.application import app, main

__all__ = [
    "app",
    "building",
    "datasets",
    "learning",
    "machine",
    "main",
    "tasks",
    "tuning",
    "viewpoints",
]
