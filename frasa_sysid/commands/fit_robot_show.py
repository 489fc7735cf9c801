"""A robot fit shown to people on the terminal."""

from rich.table import Table

from frasa_sysid.commands.bench import people_console
from frasa_sysid.robot_fit import RobotFit
from frasa_sysid.robot_fit_record import RobotFitRecord


def show_robot(found: RobotFit, record: RobotFitRecord) -> None:
    """Numbers, verdicts and errors, for people."""
    console = people_console()
    table = Table()
    for column in ("number", "before", "fitted", "95 % interval", "unit", "verdict"):
        table.add_column(
            column, justify="left" if column in ("number", "unit", "verdict") else "right", overflow="fold"
        )
    units = {free.name: free.kind.unit for free in found.problem.free}
    advice: dict[str, list[str]] = {}
    for one in record.estimates:
        if one.name in units:
            scale, unit = (
                (1e3, {"s": "ms", "rad": "mrad", "m": "mm"}[units[one.name]]) if units[one.name] != "1" else (1.0, "1")
            )
            interval = f"{one.low * scale:.4g} .. {one.high * scale:.4g}"
            colour = "green" if one.verdict == "identified" else "yellow"
            table.add_row(one.name, f"{one.nominal * scale:.4g}", f"{one.value * scale:.4g}", interval, unit,
                          f"[{colour}]{one.verdict}[/{colour}]")  # fmt: skip
            if one.advice:
                advice.setdefault(one.advice, []).append(one.name)
    console.print(table)
    for words, names in advice.items():
        console.print(f"  {', '.join(names)}: {words}")
    for words in record.not_in_model:
        console.print(f"  {words}")
    for stage, channels in found.errors.items():
        parts = [f"{name} {pair[0]:.4g}" for name, pair in channels.items()]
        console.print(f"  mean error {stage}: {', '.join(parts)} (rad, rad/s)")
    console.print(f"{found.settled.evaluations} robots simulated, {found.seconds:.0f} s")
