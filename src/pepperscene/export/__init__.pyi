from .formats import FORMATS as FORMATS
from .formats import ExportFormat as ExportFormat
from .run import ExportResult as ExportResult
from .run import Splits as Splits
from .run import export_dataset as export_dataset
from .run import read_splits as read_splits
from .run import split_by_sets as split_by_sets
from .simulators.run import export_scene as export_scene
