"""What a set of bench logs can tell, in words: one small rule a parameter, each with its reason.

The rules look at what the logs contain, not at a fit: they say beforehand what an
interval would show afterwards, and which log to record next. They are coarse on
purpose; the numbers in them are the ones a person would look at.
"""

from collections.abc import Callable, Sequence

import numpy as np

from frasa_sysid.finding import Finding, Verdict
from frasa_sysid.identifiability_effects import (
    LOAD,
    direction,
    goal_profile,
    is_bare,
    sag,
    small_errors,
    stribeck,
    zero_offset,
)
from frasa_sysid.inspection import Motion, motions
from frasa_sysid.readers.sampling import plural
from frasa_sysid.readout import RECORD, SEPARATED, separate
from frasa_sysid.recording import Recording
from frasa_sysid.servo import Servo

FINE = 0.0005  # rad; noise of a position that shows no steps
DECLARE = "declare the load's mass and length: --mass KG --length M of 'import' (of 'fit' if all have the same)"


def findings(motions: Sequence[Motion]) -> list[Finding]:
    """All verdicts for a set of bench runs, most needed first; none without a bench run."""
    return [rule(motions) for rule in RULES] if motions else []


def bench_findings(recordings: Sequence[Recording], servo: Servo | None = None) -> list[Finding]:
    """All verdicts for the recordings of one servo, those about its clocks last; none without a bench run.

    Args:
        recordings: of one servo type.
        servo: that type, where it is none that comes with frasa.
    """
    found = findings(motions(recordings, servo))
    return [*found, _readout(recordings)] if found else []


def _readout(recordings: Sequence[Recording]) -> Finding:
    # Goal and position only tell the sum of both delays; the duty beside them tells more.
    name = "read-out delay"
    if not any(one.rig.control == "position" for one in recordings):
        return Finding(name, "no", "no firmware loop at work whose duty could tell how old a reading is")
    known = separate(recordings)
    if known.verdict == SEPARATED:
        return Finding(name, "yes", known.words())
    # A duty that is no gain times the error stays so: only another channel, or none, can be recorded better.
    return Finding(name, "weak", known.words(), "" if known.explained and not known.loop_gain else RECORD)


def next_logs(found: Sequence[Finding]) -> list[str]:
    """Which logs to record next, the most missed first."""
    missed = [one for verdict in ("no", "weak") for one in found if one.verdict == verdict and one.record]
    return list(dict.fromkeys(one.record for one in missed))


def _gain(motions: Sequence[Motion]) -> Finding:
    # The gain is torque over error: without a torque known otherwise only ratios come out.
    name = "gain (kp)"
    driven = [one for one in motions if one.has_drive]
    if not driven:
        return Finding(name, "no", "no goal and no voltage command was recorded", "log what was commanded")
    loaded = [one for one in driven if one.gravity and one.lift > 0.3]
    inertial = [one for one in driven if one.inertia_known]
    if is_bare(driven):
        return Finding(name, "weak", "a bare horn: torques come out only in proportion to the armature", LOAD)
    if not (loaded or inertial):
        record = f"hang a known load on the arm; {DECLARE}"
        return Finding(name, "weak", "no known load: torques come out only in proportion to the armature", record)
    known = loaded or inertial
    error = max(one.error_p95 for one in known)
    resolution = max(FINE, *(one.quantum for one in known))
    if all(one.control == "position" for one in known) and error < 5 * resolution:
        reason = f"the error stays within {error:.4f} rad, {error / resolution:.1f} steps of the encoder"
        return Finding(name, "weak", reason, "a heavier load or a lower firmware gain")
    if not loaded:
        return Finding(name, "weak", "known inertia but no gravity: the scale rests on accelerations alone")
    return Finding(
        name, "yes", f"known load lifted, {plural(len(loaded), 'run')}, tracking error up to {error:.3f} rad"
    )


def _force_limit(motions: Sequence[Motion]) -> Finding:
    # The limit shows only where the controller asks for more than there is.
    name = "force limit"
    if any(one.control == "voltage" for one in motions):
        return Finding(name, "no", "open-loop voltage: the firmware's limit is not in play")
    record = "a step of the goal by 1 rad or more at the highest firmware gain"
    shares = [one.saturated for one in motions if one.saturated is not None]
    if shares:
        often = f"in up to {100 * max(shares):.0f} % of a run" if max(shares) > 0 else "nowhere"
        reason = f"by its recorded duty or nominal numbers the servo saturates {often}"
        verdict: Verdict = "yes" if max(shares) > 0.02 else "weak" if max(shares) > 0 else "no"
        return Finding(name, verdict, reason, "" if verdict == "yes" else record)
    error = max(one.error_p95 for one in motions)
    if error > 0.3:
        return Finding(name, "weak", f"servo or gain not known; errors of {error:.2f} rad may saturate it")
    return Finding(name, "no", f"errors stay below {error:.2f} rad, too small to saturate", record)


def _damping(motions: Sequence[Motion]) -> Finding:
    # Viscous friction and back-EMF act alike; only with the motor off is the latter gone.
    name = "damping (friction apart from back-EMF)"
    free = [one for one in motions if one.free_travel > 0.1]
    if free:
        reason = (
            f"{plural(len(free), 'run')} with the torque off, moving up to {max(o.free_travel for o in free):.2f} rad"
        )
        return Finding(name, "yes", reason)
    speed = max(one.top_speed for one in motions)
    reason = f"never moves with the torque off: only the sum is seen, at up to {speed:.1f} rad/s"
    return Finding(
        name,
        "weak" if speed > 1 else "no",
        reason,
        "turn the torque off while it moves, such as lift_and_drop, and let it swing out",
    )


def _friction_loss(motions: Sequence[Motion]) -> Finding:
    # Coulomb friction changes sign with the speed; everything else is smooth there.
    name = "friction loss"
    reversals = sum(one.reversals for one in motions)
    slow = max(one.slow_share for one in motions)
    reason = f"{reversals} reversals, slow motion in up to {100 * slow:.0f} % of a run"
    record = "slow motion to and fro, such as up_and_down or sin_sin"
    if reversals >= 4:
        return Finding(name, "yes", reason)
    return Finding(name, "weak" if reversals or slow > 0.2 else "no", reason, record)


def _armature(motions: Sequence[Motion]) -> Finding:
    # Inertia shows in accelerations; a typical armature of 0.02 kg m^2 needs 10 rad/s^2 for 0.2 N m.
    name = "armature"
    top = max(one.top_acceleration for one in motions)
    reason = f"accelerations up to {top:.0f} rad/s^2"
    if is_bare(motions):
        return Finding(name, "weak", f"{reason}, but of a bare horn: only its ratio to the gain shows", LOAD)
    if not any(one.inertia_known for one in motions):
        return Finding(name, "weak", f"{reason}, but the load's inertia is not known", DECLARE)
    if top > 10:
        return Finding(name, "yes", reason)
    return Finding(name, "weak" if top > 3 else "no", reason, "fast goals, such as sin_time_square, with a light load")


def _delay(motions: Sequence[Motion]) -> Finding:
    # A delay shifts the goal by delay * speed: 5 ms must be more than the encoder's step.
    name = "command delay"
    if all(one.control == "voltage" for one in motions):
        return Finding(name, "no", "open-loop voltage: no goal that could be late")
    driven = [one for one in motions if one.has_drive and one.control == "position"]
    if not driven:
        return Finding(name, "no", "no goal angles were recorded", "log the goals with their stamps")
    best = max(driven, key=lambda one: one.goal_speed)
    reason = f"goals up to {best.goal_speed:.1f} rad/s, position every {1e3 * best.period:.1f} ms"
    record = "fast or stepping goals, position read at 100 Hz or more"
    if best.goal_speed * 0.005 < 2 * max(best.quantum, FINE) or best.period > 0.05:
        return Finding(name, "no", reason, record)
    if best.period > 0.02:
        return Finding(name, "weak", f"{reason}: slower than delays are", record)
    if best.clock == "log":
        return Finding(name, "weak", f"{reason}, but log times carry the recorder's jitter", "fill in header stamps")
    return Finding(name, "yes", reason)


def _supply(motions: Sequence[Motion]) -> Finding:
    # Gain and force limit are proportional to it.
    name = "supply voltage"
    measured = [one.supply for one in motions if one.supply is not None]
    if not measured:
        return Finding(name, "no", "not measured: the declared one is believed", "log the servo's input voltage")
    low, high = min(low for low, _, _ in measured), max(high for _, _, high in measured)
    median = float(np.median([middle for _, middle, _ in measured]))
    runs = f"{len(measured)} of {plural(len(motions), 'run')}"
    reason = f"measured in {runs}, {low:.1f} to {high:.1f} V, median {median:.1f} V"
    return Finding(name, "yes" if len(measured) == len(motions) else "weak", reason)


def _load_friction(motions: Sequence[Motion]) -> Finding:
    # Friction that grows with the load is a constant as long as the load is one.
    name = "load-dependent friction"
    record = "the same motions with a second load, at least a third heavier or lighter"
    if is_bare(motions):
        return Finding(name, "no", "a bare horn carries no load", LOAD)
    # A bare horn beside a load is a second load, of zero.
    loads = sorted({round(one.gravity, 3) for one in motions if one.gravity is not None})
    if not loads:
        return Finding(name, "no", "no known load", record)
    if len(loads) == 1:
        return Finding(name, "no", f"one load only ({loads[0]:.2f} N m)", record)
    reason = f"{len(loads)} loads, {loads[0]:.2f} to {loads[-1]:.2f} N m"
    return Finding(
        name, "yes" if loads[-1] > 1.3 * loads[0] else "weak", reason, "" if loads[-1] > 1.3 * loads[0] else record
    )


RULES: tuple[Callable[[Sequence[Motion]], Finding], ...] = (
    _gain,
    _force_limit,
    _damping,
    _friction_loss,
    _armature,
    _delay,
    _supply,
    _load_friction,
    direction,
    stribeck,
    zero_offset,
    sag,
    goal_profile,
    small_errors,
)
