"""A bench fit shown to people on the terminal."""

from rich.console import Console
from rich.table import Table

from frasa_sysid.choice import Choice
from frasa_sysid.commands.bench import people_console
from frasa_sysid.effects import EFFECTS
from frasa_sysid.fit import FitResult
from frasa_sysid.fit_record import Extras
from frasa_sysid.pieces import ONE_LOG, count_of, one_log_in_pieces


def show(result: FitResult, extras: Extras) -> None:
    """Print what was found, for people."""
    console = people_console()
    table = Table(title=f"{result.problem.servo.name}, friction law {result.friction}", title_justify="left")
    for heading in ("parameter", "nominal", "fitted", "95 % interval", "unit", "verdict"):
        table.add_column(
            heading, justify="right" if heading in ("nominal", "fitted", "95 % interval") else "left", overflow="fold"
        )
    for one in result.evidence.estimates:
        colour = "green" if one.verdict == "identified" else "yellow"
        interval = f"{one.low:.4g} .. {one.high:.4g}"
        verdict = f"[{colour}]{one.verdict}[/{colour}]"
        table.add_row(one.name, f"{one.nominal:.4g}", f"{one.value:.4g}", interval, one.unit, verdict)
    console.print(table)
    for one in result.evidence.estimates:
        if one.advice:
            console.print(f"  {one.name} is {one.verdict}: {one.advice}")
    if extras.readout is not None:
        console.print(f"  {result.problem.servo.name}.delay: {extras.readout.words()}")
    if extras.delay_doubt:
        console.print(f"  [yellow]doubtful[/yellow]: {extras.delay_doubt}")
    if result.problem.effects:
        for name in result.problem.effects:
            console.print(f"  with {name}: {EFFECTS[name].meaning}")
    if extras.choice is not None:
        show_choice(console, extras.choice)
    if extras.stand_in is not None:
        other = extras.stand_in
        console.print(
            f"M1 in its place (--as m1): {other.penalty.mae_rad * 1e3:.2f} mrad from it on these motions, "
            f"loads {other.loads[0]:.2f} to {other.loads[1]:.2f} N m, up to {other.speed:.1f} rad/s"
        )
    errors = f"mean error {result.nominal.mae_rad * 1e3:.2f} mrad nominal, {result.fitted.mae_rad * 1e3:.2f} fitted"
    if result.problem.held_out:
        held_out = count_of(result.problem.held_out).replace(" run", " held-out run")
        errors += (
            f"; on {held_out} {result.held_out_nominal.mae_rad * 1e3:.2f} nominal, "
            f"{result.held_out.mae_rad * 1e3:.2f} fitted"
        )
    console.print(errors)
    if one_log_in_pieces(result.problem.train):
        console.print(f"[yellow]one log[/yellow]: {ONE_LOG}")
    if result.solved.multimodal:
        costs = ", ".join(f"{one.cost * 1e3:.2f}" for one in result.solved.restarts if one.start.startswith("seed"))
        console.print(f"[yellow]multimodal[/yellow]: searches ended at costs of {costs} mrad; the lowest is kept")
    console.print(
        f"{result.evaluations} evaluations, {result.seconds:.1f} s, seed {result.problem.seed}; {result.stop.value}"
    )


def show_choice(console: Console, choice: Choice) -> None:
    """Print how the models that were weighed compare, for people."""
    table = Table(title="held-out errors", title_justify="left")
    for heading in ("model", "numbers", "all runs, mrad", "held out, mrad", "p", "against"):
        table.add_column(heading, justify="left" if heading in ("model", "against") else "right", overflow="fold")
    for one in (*choice.effects, *choice.laws):
        p_value = "" if one.p_value != one.p_value else f"{one.p_value:.3f}"
        name = " + ".join((one.law, *one.effects))
        table.add_row(
            name, str(one.numbers), f"{one.train * 1e3:.2f}", f"{one.held_out * 1e3:.2f}", p_value, one.against
        )
    console.print(table)
    console.print(f"  {choice.reason}")
