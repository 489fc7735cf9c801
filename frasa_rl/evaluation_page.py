"""The page of an evaluation: the paper's tables, every trial, and what the controller does."""

from pathlib import Path
from typing import Any

from frasa_rl.controllers import Controller
from frasa_rl.evaluate import is_policy
from frasa_rl.foreign import is_foreign
from frasa_rl.page_parts import protocol_picture, protocol_tables, short, strain_table
from frasa_rl.policy import Policy
from frasa_rl.protocol import Conditions
from frasa_rl.strips import push_strip, standup_strips
from frasa_sysid.calibration import write_atomic
from frasa_sysid.calibration.figures import has_matplotlib, look
from frasa_sysid.calibration.page import Html, card, cards, join, page, section, table, tag


def write_evaluation_page(
    path: Path, result: dict[str, Any], controller: Controller, conditions: Conditions
) -> Path | None:
    """Write the page.

    Args:
        path: HTML file to make.
        result: what `frasa-rl evaluate --json` prints.
        controller: that was measured, for the pictures.
        conditions: of the trials.

    Returns:
        The file, or None where matplotlib is not installed.
    """
    if not has_matplotlib():
        return None
    with look():
        picture = protocol_picture(result)
    strips = [standup_strips(controller, conditions)] if result["standup"] else []
    strips += [push_strip(controller, conditions)] if result["push"] else []
    parts = [
        _summary(result),
        section("Beside the paper", protocol_tables(result), picture),
        section("What it does", *dict.fromkeys(strips)),
        section("What it asks of the robot", strain_table(result["strain"])),
        section("What this rests on", _origins(result)),
    ]
    write_atomic(path, page(f"Evaluation of {short(result['controller'])}", parts))
    return path


def _summary(result: dict[str, Any]) -> Html:
    robots = "robots and floors drawn at random" if result["randomized"] else "the robot as its file says"
    words = f"{short(result['controller'])} on {short(str(result['model']))}: {robots}, "
    words += f"{result['rate_hz']:g} decisions a second."
    found = [_standup_card(side, one) for side, one in result["standup"].items()]
    pushes = result["push"]
    if pushes:
        trials = sum(one["trials"] for one in pushes)
        stable = sum(round(one["success_rate"] * one["trials"]) for one in pushes)
        falls = sum(one["falls"] for one in pushes)
        found.append(card("pushes", f"{stable} of {trials}", "stable again", f"{falls} times it fell on the way"))
    return join([tag("p", words), cards(found)])


def _standup_card(side: str, one: dict[str, Any]) -> Html:
    share = f"{100 * one['success_rate']:.0f} % of {one['trials']} trials"
    paper, mean = one["paper_s"]["agent"][0], one["time_mean_s"]
    if mean is None:
        return card(f"from {side}", "0 %", "stand up", share)
    return card(f"from {side}", f"{mean:.2f}", "s", f"{share}; the paper's agent: {paper:g} s")


def _origins(result: dict[str, Any]) -> Html:
    word = str(result["controller"])
    rows = [
        ["controller", short(word)],
        ["model", short(str(result["model"]))],
        ["calibration id", tag("code", result["calibration_id"] or "none: a nominal model")],
        ["seed of all trials", result["seed"]],
        ["schema", result["schema"]],
    ]
    if is_policy(word) and not is_foreign(word):
        rows += _trained(Policy.load(word).run)
    return table(("", ""), rows)


def _trained(run: dict[str, Any]) -> list[list[object]]:
    """How a policy was trained."""
    trained, versions = run.get("trained") or {}, run.get("versions") or {}
    steps, minutes = trained.get("steps"), trained.get("minutes")
    rows: list[list[object]] = []
    if isinstance(steps, int | float) and isinstance(minutes, int | float):
        rows.append(["trained", f"{steps:,.0f} steps, {minutes:.1f} minutes"])
    if isinstance(versions, dict) and versions:
        rows.append(["versions in training", ", ".join(f"{name} {one}" for name, one in versions.items())])
    return rows
