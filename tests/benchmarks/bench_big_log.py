"""A long log of a robot: what inspecting and fitting it takes, in processor time and memory, beside its raw bytes.

    python tests/benchmarks/bench_big_log.py [--hours 2] [--rate 1000] [--joints 20] [--log FILE] [--only inspect,fit]
    python tests/benchmarks/bench_big_log.py --many 1000

The log is made once (`big_log.py`) and kept where --log says. Each command runs in a process of its own, whose peak
memory is what the system counted. Beside it: the `mcap` library handing out the raw messages, and decoding them. With
--many it is so many logs of a bench, each 6 s long, on one command line, with 256 open files allowed.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from big_log import GAIN, write

from frasa_sysid.readers import read_log
from frasa_sysid.writer import write_mcap

RAW = """
import sys
from mcap.reader import NonSeekingReader
count = size = 0
with open(sys.argv[1], "rb") as file:
    for schema, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
        count, size = count + 1, size + len(message.data)
print(count, "messages,", size / 1e9, "GB")
"""
DECODED = """
import sys, time
from itertools import islice
from mcap.reader import NonSeekingReader
from mcap_ros2.decoder import DecoderFactory
with open(sys.argv[1], "rb") as file:
    found = NonSeekingReader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(log_time_order=False)
    begin = time.perf_counter()
    count = sum(1 for _ in islice(found, 20000))
print((time.perf_counter() - begin) / count)
"""


def child(words: list[str]) -> tuple[float, float, int, str]:
    """Seconds of processor time, peak memory [MB], exit status and output of a process."""
    with tempfile.TemporaryFile("w+") as out:
        process = subprocess.Popen(words, stdout=out, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        text = out.read()
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, process.returncode, text


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--joints", type=int, default=20)
    parser.add_argument("--log", type=Path)
    parser.add_argument("--only", default="raw,decoded,inspect,inspect-between,fit,fit-between")
    parser.add_argument("--many", type=int, help="so many short logs in place of a long one")
    args = parser.parse_args()
    if args.many:
        measure_many(args.many)
        return
    with tempfile.TemporaryDirectory() as folder:
        log = args.log or Path(folder) / "big.mcap"
        if not log.exists():
            begin = time.perf_counter()
            count = write(log, 3600 * args.hours, args.rate, args.joints)
            print(f"made in {time.perf_counter() - begin:.0f} s: {count} messages", flush=True)
        print(
            f"{log.name}: {args.hours:g} h, {args.rate:g} Hz, {args.joints} joints, {log.stat().st_size / 1e9:.2f} GB"
        )
        measure(log, Path(folder), args.only.split(","))


def measure_many(count: int) -> None:
    """Inspect and fit many logs: runs of the bench in the repository, a file each, again and again."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))
    frasa = [sys.executable, "-m", "frasa_sysid.cli"]
    with tempfile.TemporaryDirectory() as folder:
        logs, one = Path(folder) / "logs", Path(folder) / "one.mcap"
        logs.mkdir()
        files = []
        for recording in read_log(Path("bench_logs/mx106.mcap"))[:20]:
            write_mcap(one, [recording])
            files.append(one.read_bytes())
        for i in range(count):
            (logs / f"log{i:04d}.mcap").write_bytes(files[i % len(files)])
        for name, words in {
            "inspect": ["inspect", *map(str, sorted(logs.iterdir()))],
            "fit": ["fit", str(logs), "--out", str(Path(folder) / "mx106.json")],
        }.items():
            seconds, memory, status, text = child([*frasa, *words])
            lines = len(text.splitlines())
            print(f"{name}: {seconds:.0f} s of processor time, {memory:.0f} MB at most, {lines} lines, exit {status}")
        print(f"page: {(Path(folder) / 'mx106.html').stat().st_size / 1e6:.1f} MB")


def measure(log: Path, folder: Path, only: list[str]) -> None:
    frasa = [sys.executable, "-m", "frasa_sysid.cli"]
    fit = [
        *frasa,
        "fit",
        str(log),
        "--base",
        "fixed",
        "--firmware-gain",
        f"{GAIN:g}",
        "--out",
        str(folder / "fit.json"),
    ]
    commands = {
        "raw": [sys.executable, "-c", RAW, str(log)],
        "inspect": [*frasa, "inspect", str(log)],
        "inspect-between": [*frasa, "inspect", str(log), "--between", "150", "180"],
        "fit": fit,
        "fit-between": [*fit, "--between", "150", "180"],
    }
    raw = None
    for name, words in commands.items():
        if name not in only:
            continue
        seconds, memory, status, text = child(words)
        raw = seconds if name == "raw" else raw
        ratio = f", {seconds / raw:.2f} of the raw reading" if raw else ""
        print(
            f"\n== {name}: {seconds:.0f} s of processor time, {memory:.0f} MB at most, exit {status}{ratio}\n{text}",
            flush=True,
        )
    if "decoded" in only:
        text = child([sys.executable, "-c", DECODED, str(log)])[3]
        print(f"the libraries' own decoder takes {1e6 * float(text):.0f} us a message")


if __name__ == "__main__":
    main()
