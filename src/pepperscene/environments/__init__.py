"""Environments of gymnasium in a crop: views that see all ripe fruit, and reaching for a cut point.

Importing the package registers them.
"""

from pepperscene.environments.registration import ENVIRONMENTS
from pepperscene.learning.tasks.view_scenes import ViewTask

__all__ = ["ENVIRONMENTS", "ViewTask"]
