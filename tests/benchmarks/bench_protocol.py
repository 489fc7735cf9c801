"""The paper's tables for doing nothing and for the keyframes: nominal and calibrated model, 20 and 100 Hz.

python tests/benchmarks/bench_protocol.py [CONTROLLER...]
"""

import sys
import time
from pathlib import Path

from frasa_rl.evaluate import evaluate, find_controller
from frasa_rl.protocol import Conditions, evaluation_task
from frasa_rl.protocol_tables import tables
from frasa_sysid.calibration import calibration_id, load_model


def main() -> None:
    """Print them."""
    for word in sys.argv[1:] or ("nothing", "keyframes"):
        for model in (Path("robot_model/nominal.xml"), Path("robot_model/calibrated.xml")):
            for rate in (20.0, 100.0):
                controller, path = find_controller(word, model, evaluation_task(), allow_other_model=True)
                asked = Conditions(model=path, task=evaluation_task(), rate_hz=rate)
                began = time.perf_counter()
                done = evaluate(controller, asked, 20, 10)
                said = {"controller": word, "model": path, "rate_hz": rate, "randomized": False, "seed": asked.seed}
                print(tables({**done.to_dict(), **said, "calibration_id": calibration_id(load_model(path))}))
                print(f"(40 falls and 60 pushes in {time.perf_counter() - began:.0f} s)\n", flush=True)


if __name__ == "__main__":
    main()
