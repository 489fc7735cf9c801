"""From servo logs to a calibrated MuJoCo model.

bench_logs/*.mcap -> Recording -> FitProblem -> FitResult -> Calibration -> calibrated.xml + randomization.yaml
"""

__version__ = "0.1.0"
