"""frasa-rl play."""

import argparse
from pathlib import Path
from typing import Any

from frasa_rl.commands.arguments import CONTROLLER_HELP, add_conditions, conditions
from frasa_rl.film import film_push, film_standup
from frasa_rl.protocol import LIMIT_S, SIDES
from frasa_rl.push_rig import DIRECTIONS
from frasa_rl.render import FORMATS, check_format, save_film
from frasa_sysid.calibration import UsageError, add_json_flag, say

_STARTS = (*SIDES, *(f"push-{one}" for one in DIRECTIONS))


def add_command(commands: Any) -> None:  # noqa: ANN401 - argparse keeps this type private
    """Add `play` to the command line."""
    parser = commands.add_parser("play", help="film one trial: standing up, or a push")
    parser.add_argument("controller", help=CONTROLLER_HELP)
    add_conditions(parser)
    parser.add_argument("--video", type=Path, required=True, help=f"file to write ({', '.join(FORMATS)})")
    parser.add_argument("--start", choices=_STARTS, default="prone", help="how it begins (default prone)")
    parser.add_argument("--energy", type=float, help="of a push [J] (default: the largest of the rig's, 7.3)")
    parser.add_argument("--seconds", type=float, default=LIMIT_S, help=f"longest film (default {LIMIT_S:g})")
    parser.add_argument("--pictures", type=int, default=8, help="in the strip of a png (default 8)")
    parser.add_argument("--randomize", action="store_true", help="draw robot and floor, as in training")
    add_json_flag(parser)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> dict[str, Any]:
    check_format(args.video)
    if not 0.1 <= args.seconds <= 60.0:
        raise UsageError("--seconds must be from 0.1 to 60")
    if not 1 <= args.pictures <= 100:
        raise UsageError("--pictures must be from 1 to 100")
    controller, asked = conditions(args, args.controller, args.model, randomize=args.randomize)
    if args.start in SIDES:
        film = film_standup(controller, asked, args.start, args.seconds)
        good, bad = "stood up after", "did not stand up"
    else:
        direction = next(one for one in DIRECTIONS if args.start == f"push-{one}")
        energy = asked.task.rig.energies_j[-1] if args.energy is None else args.energy
        film = film_push(controller, asked, (direction, energy), args.seconds)
        good, bad = "stable again after", "was not stable again"
    save_film(film.frames, args.video, film.frames_per_s, args.pictures)
    bad = bad if film.stood else "did not stand before the push"
    said = bad if film.time_s is None else f"{good} {film.time_s:.2f} s"
    say(f"{args.video}: {len(film.frames)} pictures, {said}")
    return {"schema": "frasa.play/1", "video": args.video, "frames": len(film.frames), "time_s": film.time_s}
