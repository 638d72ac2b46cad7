from .options import CalibrationOptions as CalibrationOptions
from .result import ChartCalibration as ChartCalibration
from .run import calibrate as calibrate
