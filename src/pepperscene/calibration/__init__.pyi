from .options import CalibrationOptions as CalibrationOptions
from .run import ChartCalibration as ChartCalibration
from .run import calibrate as calibrate
