"""Options of `frasa-sysid fit` for logs of a bench, each with what logs of a whole robot take in its place."""

from frasa_sysid.calibration.friction import LAWS
from frasa_sysid.commands.log_kinds import KindGroup
from frasa_sysid.effects import EFFECTS
from frasa_sysid.fit import RESTARTS


def add_bench_options(bench: KindGroup) -> None:
    """How a bench is fitted: what is free, what is held out, how it is searched."""
    bench.add(
        "--friction",
        choices=(*LAWS, "auto"),
        default="m1",
        help="friction law, or the one held-out runs speak for",
        instead="has the friction laws of its bench fits (--frozen FIT)",
    )
    bench.add(
        "--effects",
        metavar="LIST",
        help=f"none, auto, or of {', '.join(EFFECTS)} [auto with --friction auto, else none]",
        instead="takes --free LIST",
    )
    bench.add(
        "--hold-out",
        default="none",
        metavar="RULE",
        help="none; kp=24, mass=0.969, length=0.1, trajectory=NAME; or kp, rig, trajectory for the last of each",
        instead="takes --hold-out-share S",
    )
    searched = "is fitted by least squares, without a search"
    bench.add(
        "--optimizer", choices=("cmaes+lsq", "cmaes"), default="cmaes+lsq", help="[%(default)s]", instead=searched
    )
    bench.add("--restarts", type=int, default=RESTARTS, help="searches that must agree [%(default)s]", instead=searched)
    bench.add("--evaluations", type=int, metavar="N", help="search budget [60 per parameter]", instead=searched)
    bench.add(
        "--bootstrap",
        type=int,
        default=0,
        metavar="N",
        help="resampled logs to fit anew [0]",
        instead="has its intervals without",
    )
    bench.add(
        "--first",
        type=float,
        metavar="S",
        help="use the first S seconds of each run",
        instead="takes --between FROM TO",
    )
    bench.add(
        "--shooting",
        type=float,
        metavar="S",
        help="cut runs into pieces of S s (diverging logs)",
        instead="is always fitted in pieces",
    )
    bench.add(
        "--timestep",
        type=float,
        metavar="S",
        help="physics step [that of the bench model]",
        instead="has the step of its --model",
    )
    bench.add(
        "--duty-age",
        type=float,
        metavar="S",
        help="age of a logged duty at its stamp, where known",
        instead="takes --position-delay S",
    )
    bench.add(
        "--jobs",
        type=int,
        default=1,
        help="processes for folds and bootstraps [%(default)s]",
        instead="takes --threads N",
    )
    bench.add(
        "--cluster",
        metavar="ADDRESS",
        help="Dask scheduler to do them, such as tcp://host:8786",
        instead="takes --threads N",
    )
