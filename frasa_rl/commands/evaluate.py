"""frasa-rl evaluate."""

import argparse
from pathlib import Path
from typing import Any

from frasa_rl.commands.task_option import add_task_option, chosen_task
from frasa_rl.evaluate import SCHEMA, check_policy, evaluate, evaluation_task
from frasa_rl.policy import Policy
from frasa_rl.standup_env import StandUp
from frasa_sysid.calibration import UsageError, add_json_flag, say

NOTHING = "nothing"
DEFAULT_MODEL = Path("robot_model/calibrated.xml")


def add_command(commands: Any) -> None:  # noqa: ANN401 - argparse keeps this type private
    """Add `evaluate` to the command line."""
    parser = commands.add_parser("evaluate", help="success rate and time of a policy, from prone and supine")
    add_policy(parser)
    parser.add_argument("--trials", type=int, default=20, help="trials from each side (default 20)")
    parser.add_argument("--seed", type=int, default=10_000, help="seed of the first trial (default 10000)")
    add_json_flag(parser)
    parser.set_defaults(run=_run)


def add_policy(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say which policy on which model."""
    parser.add_argument("policy", help="a run or policy folder, or 'nothing' (every command held)")
    parser.add_argument("--model", type=Path, help="model file (default: the one the policy was trained on)")
    parser.add_argument("--allow-other-model", action="store_true", help="run it on another calibration than its own")
    add_task_option(parser)


def load_both(args: argparse.Namespace, render_mode: str | None = None) -> tuple[Policy | None, StandUp]:
    """The policy and the environment the arguments name, checked against each other."""
    policy = None if args.policy == NOTHING else Policy.load(args.policy)
    trained_on = Path(str(policy.run.get("model", DEFAULT_MODEL))) if policy else DEFAULT_MODEL
    env = StandUp(args.model or trained_on, evaluation_task(chosen_task(args, policy)), render_mode=render_mode)
    if policy:
        check_policy(policy, env, allow_other_model=args.allow_other_model)
    return policy, env


def _run(args: argparse.Namespace) -> dict[str, Any]:
    if args.trials < 1 or args.seed < 0:
        raise UsageError("--trials must be at least 1 and --seed not negative")
    policy, env = load_both(args)
    standup = evaluate(policy, env, args.trials, args.seed)
    for side, one in standup.items():
        time = f", {one['time_mean_s']:.2f} +- {one['time_std_s']:.2f} s" if one["success_rate"] else ""
        say(f"{side:>7}: {100.0 * one['success_rate']:.0f} % of {one['trials']} stand up{time}")
    say("pushes are not evaluated yet: 'push' is empty")
    return {
        "schema": SCHEMA,
        "standup": standup,
        "push": [],
        "controller": args.policy,
        "model": args.model or (policy.run.get("model") if policy else None) or DEFAULT_MODEL,
        "calibration_id": env.calibration_id,
        "seed": args.seed,
        "divergences": env.divergences,
    }
