"""From servo logs to a calibrated MuJoCo model.

bench_logs/*.mcap -> Recording -> FitProblem -> FitResult -> Calibration -> calibrated.xml + randomization.yaml
"""

import os

__version__ = "0.1.0"

# Every matrix here is small, and threads of frasa's own keep the cores busy: threads of the linear algebra beside
# them make a singular value decomposition up to 200 times slower. It works where numpy was not imported before.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
