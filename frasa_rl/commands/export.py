"""frasa-rl export."""

import argparse
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from frasa_rl.commands.arguments import add_trust, chosen_task_of
from frasa_rl.commands.task_option import add_task_option
from frasa_rl.deployment import deployment
from frasa_rl.evaluate import check_model, find_policy
from frasa_rl.export import check_published, publish
from frasa_rl.foreign import is_foreign
from frasa_sysid.calibration import UsageError, add_json_flag, alone, say

SCHEMA = "frasa.export/1"


def add_command(commands: Any) -> None:  # noqa: ANN401 - argparse keeps this type private
    """Add `export` to the command line."""
    parser = commands.add_parser("export", help="a policy as a folder for the robot: safetensors, ONNX, what to know")
    parser.add_argument("policy", help="a run or policy folder, or an SB3 file (.zip)")
    parser.add_argument("--out", type=Path, help="folder to write (default: 'export' in the policy's folder)")
    parser.add_argument("--model", type=Path, help="model file (default: the one it was trained on)")
    parser.add_argument("--allow-other-model", action="store_true", help="describe another model than its own")
    add_trust(parser)
    add_task_option(parser, "the policy's own; for an SB3 file the Sigmaban's")
    add_json_flag(parser)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> dict[str, Any]:
    for package in ("onnx", "safetensors"):
        if not find_spec(package):
            raise UsageError(f"export needs {package}: pip install 'frasa[export]'")
    foreign = is_foreign(args.policy)
    if args.task is not None and not foreign:
        raise UsageError("--task is for SB3 files: a policy folder says itself what it was trained for")
    task = chosen_task_of(args, args.policy)
    policy, model = find_policy(
        args.policy, args.model, task, allow_other_model=args.allow_other_model, trust=args.trust
    )
    deploy = deployment({"origin": f"run {Path(args.policy).resolve().name}", **policy.run}, task, model)
    if not args.allow_other_model and deploy["model"]["calibration_id"]:  # a nominal one was compared above
        check_model(policy.run, deploy["model"]["sha256"], model)
    out: Path = args.out or (Path(args.policy).with_suffix("") if foreign else Path(args.policy) / "export")
    with alone(out, folder=True):
        files = publish(policy, deploy, out)
        agreement = check_published(policy, deploy, out)
    size = sum(one.stat().st_size for one in files)
    say(f"{out}: {', '.join(one.name for one in files)}, {size / 1e6:.1f} MB")
    say("differ from the policy by at most " + ", ".join(f"{one:.0e} ({name})" for name, one in agreement.items()))
    if task.compat:
        say(f"trained with compat {task.compat}: runtime.py does not keep its histories, use Network or the ONNX file")
    return {
        "schema": SCHEMA,
        "folder": out,
        "files": [one.name for one in files],
        "bytes": size,
        "agreement": agreement,
        "calibration_id": deploy["calibration_id"],
        "model": model,
        "rates_hz": [deploy["control"]["lowest_hz"], deploy["control"]["highest_hz"]],
    }
