"""A process that reads inputs for a campaign, one after the other, watched and within bounds.

    python -m fuzzing.worker FORMAT MEMORY_MIB

On standard input: one JSON object a line, {"path": ..., "allowed": ...}; on standard output what came of it. Address
space is bounded to what the process has after its imports and a good input, plus MEMORY_MIB.
"""

import contextlib
import gc
import io
import json
import os
import resource
import sys
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

from fuzzing import watch
from fuzzing.case import put
from fuzzing.targets import targets


def main() -> None:
    """Read until standard input ends."""
    name, megabytes, scratch = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
    # What libraries print must not be taken for answers.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    warnings.simplefilter("ignore")
    os.chdir(scratch)
    target = targets()[name]
    read = target.reader()
    for case in target.seeds():
        with contextlib.redirect_stderr(io.StringIO()):
            read(put(case, scratch / "warm"))
    limit = _status("VmSize") + megabytes * 1024 * 1024
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    watch.begin(scratch)
    print(json.dumps({"ready": True}), file=answers, flush=True)
    for line in sys.stdin:
        print(json.dumps(_answer(read, Path(json.loads(line)["path"]))), file=answers, flush=True)


def _answer(read: Any, path: Path) -> dict[str, Any]:
    from frasa_sysid.calibration.errors import FrasaError

    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    before = _status("VmRSS")
    watch.events.clear()
    said, start = io.StringIO(), time.process_time()
    answer: dict[str, Any] = {"losses": 0}
    try:
        with contextlib.redirect_stderr(said):
            answer |= {"outcome": "read", "losses": int(read(path))}
    except FrasaError as error:
        text = str(error)
        plain = text.isprintable() and 10 < len(text) < 2000
        answer |= {"outcome": "refused" if plain and error.exit_code == 3 else "unclear", "detail": text[:1500]}
        if error.exit_code != 3:
            answer["detail"] = f"exit code {error.exit_code}: {answer['detail']}"
    except MemoryError:
        answer |= {"outcome": "memory", "detail": "".join(traceback.format_exc()[-1500:])}
    except (Exception, SystemExit):
        answer |= {"outcome": "traceback", "detail": traceback.format_exc()[-2500:]}
    answer["seconds"] = time.process_time() - start
    answer["peak"] = max(_status("VmHWM") - before, 0)
    if watch.events:
        answer["executed"] = sorted(watch.events)[:10]
    if answer["peak"] > 2**27:  # what a large input left must not count for the next
        gc.collect()
    return answer


def _status(name: str) -> int:
    """A number of this process [bytes]."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) * 1024
    return 0


if __name__ == "__main__":
    main()
