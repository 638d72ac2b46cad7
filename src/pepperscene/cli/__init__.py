"""The command line: parse, call, show progress, exit code; one file for each group of commands.

Exit codes: 0 done, 1 a data set has faults, 2 something that the user can mend (one line tells what), 130
interrupted.
"""

from pepperscene.cli import building, checking, comparing, exporting, machine, plants, reporting, tuning
from pepperscene.cli.application import app, main

__all__ = [
    "app", "building", "checking", "comparing", "exporting", "machine", "main", "plants", "reporting",
    "tuning",
]  # fmt: skip
