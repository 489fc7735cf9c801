"""frasa-rl play."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from frasa_rl.commands.evaluate import add_policy, load_both
from frasa_rl.evaluate import SIDES, run_trial
from frasa_rl.render import FORMATS, Frame, check_format, save_film
from frasa_sysid.calibration import add_json_flag, say


def add_command(commands: Any) -> None:  # noqa: ANN401 - argparse keeps this type private
    """Add `play` to the command line."""
    parser = commands.add_parser("play", help="film one trial of a policy")
    add_policy(parser)
    parser.add_argument("--video", type=Path, required=True, help=f"file to write ({', '.join(FORMATS)})")
    parser.add_argument("--start", choices=SIDES, default="prone", help="how the robot lies (default prone)")
    parser.add_argument("--seed", type=int, default=10_000, help="seed of the trial (default 10000)")
    add_json_flag(parser)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> dict[str, Any]:
    check_format(args.video)
    policy, env = load_both(args, render_mode="rgb_array")
    frames: list[Frame] = []
    try:
        time_s = run_trial(policy, env, args.start, args.seed, frames)
    finally:
        env.close()
    save_film(frames, args.video, 1.0 / env.task.control_period_s)
    stood = np.isfinite(time_s)
    say(f"{args.video}: {len(frames)} pictures, " + (f"stood up after {time_s:.2f} s" if stood else "did not stand up"))
    return {"schema": "frasa.play/1", "video": args.video, "frames": len(frames), "time_s": time_s}
