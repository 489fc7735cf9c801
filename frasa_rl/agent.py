"""One agent of a sweep, a process of its own: `python -m frasa_rl.agent`, with its order on standard input.

Whoever ordered it keeps standard input open. When that closes, be it because the sweep is to stop or because it was
killed, the run ends as after Ctrl-C: with everything saved. A Ctrl-C in the terminal is the sweep's, not the agent's.
"""

import json
import os
import signal
import sys
import threading
import traceback
from dataclasses import replace
from pathlib import Path
from typing import Any

from frasa_rl.places import Place
from frasa_rl.sweep_files import RESULT_FILE, ends_of
from frasa_sysid.calibration import CalibrationError, FrasaError, alone, plain, say, write_atomic

_PATIENCE_S = 60.0  # an agent whose sweep was killed is still saving


def main() -> int:
    """Train as ordered and return the exit status."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # in threads that begin later, too
    order = json.loads(sys.stdin.buffer.readline())
    threading.Thread(target=_end_with_standard_input, daemon=True).start()
    place = Place(order["count"], tuple(order["cores"]))
    place.occupy()
    try:
        _train(order["run"], Path(order["out"]), place)
    except FrasaError as error:
        say(f"frasa-rl: {error}")
        return error.exit_code
    except Exception:
        traceback.print_exc()
        return 1
    return 0


def _end_with_standard_input() -> None:
    while os.read(sys.stdin.fileno(), 1):
        pass
    signal.raise_signal(signal.SIGTERM)


def _train(said: dict[str, Any], out: Path, place: Place) -> None:
    """Begin a run, or go on with it where its folder holds one.

    Raises:
        CalibrationError: the model here is not the one of the order.
        BusyError: another process is training in that folder.
    """
    from frasa_rl.plan import plan_from
    from frasa_rl.policy import RUN_FILE
    from frasa_rl.train import train
    from frasa_sysid.calibration import load_model, model_sha256

    plan = plan_from(said, out, "the sweep")
    if model_sha256(load_model(plan.model)) != said["model_sha256"]:
        raise CalibrationError(f"{plan.model} is not the model this sweep was started with: start a new one")
    if not place.cores and plan.settings.env_threads is None:  # else it would take the whole machine
        plan = replace(plan, settings=replace(plan.settings, env_threads=place.count))
    with alone(out, folder=True, patience_s=_PATIENCE_S):
        result = train(plan, resume=(out / RUN_FILE).exists())
        done = {**plain(result), "ends": ends_of(said)}
        write_atomic(out / RESULT_FILE, json.dumps(done, indent=2, allow_nan=False) + "\n")


if __name__ == "__main__":
    sys.exit(main())
