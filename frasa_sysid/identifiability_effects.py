"""What bench logs can tell beyond Coulomb-viscous friction: a small rule for each effect, with its reason.

Advice is in the words of `evidence.RECORD`, so that before a fit and after it the same log has one name.
"""

from collections.abc import Sequence

import numpy as np

from frasa_sysid.finding import Finding
from frasa_sysid.inspection import Motion
from frasa_sysid.motion_detail import BANDS, SMALL
from frasa_sysid.readers.sampling import plural

LOAD = "hang a load of known mass and length on the arm"  # to whoever has declared that none hangs there
_ENOUGH = 1.0  # [s] of a motion, over all runs, that a fit can use
_SIDE = 0.2  # [rad] off the vertical from which on gravity tells the sides apart
_BIG_STEP = 1.0  # [rad] that any speed limit of a goal shows in
_OFTEN = 5.0  # changes of the supply in a second that can follow a motion; the fit's own limit
_SWING = 0.02  # of the supply that is more than noise of its measurement


def is_bare(motions: Sequence[Motion]) -> bool:
    """Whether all that is declared is a horn without a load: known, and zero."""
    return any(one.gravity is not None for one in motions) and not any(
        one.gravity or one.inertia_known for one in motions
    )


def stribeck(motions: Sequence[Motion]) -> Finding:
    """Friction that falls with speed is told from a constant one by several slow speeds and the stop between them."""
    name = "Stribeck friction"
    stops = sum(one.detail.standstills for one in motions)
    seconds = np.sum([one.detail.in_bands for one in motions], axis=0)
    reason = f"{plural(stops, 'passage')} through standstill under power; {seconds[0]:.1f}, {seconds[1]:.1f} and "
    reason += f"{seconds[2]:.1f} s at {BANDS[0]:g} to {BANDS[1]:g}, to {BANDS[2]:g} and to {BANDS[3]:g} rad/s"
    if stops < 4:
        return Finding(name, "no", reason, "slow motion through standstill at several speeds (sin_sin)")
    if seconds.min() < _ENOUGH:
        record = "slow motion at several speeds between 0.1 and 3 rad/s (sin_sin, up_and_down)"
        return Finding(name, "weak", reason, record)
    return Finding(name, "yes", reason)


def direction(motions: Sequence[Motion]) -> Finding:
    """The motor's share in friction is told from the load's where one drives the other, and the other way round."""
    name = "friction by direction of the load"
    loaded = [one for one in motions if one.gravity]
    if not loaded:
        return Finding(name, "no", "a bare horn" if is_bare(motions) else "no known load", LOAD)
    up, down = (sum(getattr(one.detail, way) for one in loaded) for way in ("lifting", "lowering"))
    reason = f"{up:.1f} s of lifting and {down:.1f} s of lowering under power"
    if min(up, down) >= _ENOUGH:
        return Finding(name, "yes", reason)
    lacking = "lowering and holding a heavy load (up_and_down), so that the load drives the motor"
    if up < down:
        lacking = "slow lifting of the heaviest load the servo can hold"
    return Finding(name, "weak" if min(up, down) > 0.2 * _ENOUGH else "no", reason, lacking)


def sag(motions: Sequence[Motion]) -> Finding:
    """A supply that gives way looks like a lower torque limit, unless it is measured while it does."""
    name = "supply sag"
    record = "the highest gain with the heaviest load, with the supply voltage logged at every cycle"
    if not any(one.supply for one in motions):
        return Finding(name, "weak", "supply not measured: sag is told from the torque limit by its shape only", record)
    rate = max(one.detail.supply_rate for one in motions)
    swing = max((one.detail.supply_swing for one in motions if one.detail.supply_rate >= _OFTEN), default=0.0)
    if rate < _OFTEN:
        return Finding(name, "weak", f"the measured supply changes {rate:.1f} times a second at most", record)
    reason = f"measured often enough, changing by up to {100 * swing:.1f} % within a run"
    if swing < _SWING:
        return Finding(name, "no", f"{reason}: too little to be asked about", record)
    return Finding(name, "yes", reason)


def goal_profile(motions: Sequence[Motion]) -> Finding:
    """A firmware's own speed limit shows where goals run away faster than it lets them."""
    name = "goal profile (speed limit)"
    driven = [one for one in motions if one.control == "position" and one.has_drive]
    if not driven:
        return Finding(name, "no", "no goal angles, or no firmware that could hold them back")
    step = max(one.detail.goal_step for one in driven)
    fastest, moved = max(one.goal_speed for one in driven), max(one.top_speed for one in driven)
    reason = f"goals step by up to {step:.2f} rad; up to {fastest:.1f} rad/s, the arm up to {moved:.1f} rad/s"
    if step >= _BIG_STEP or fastest > 1.3 * moved:
        return Finding(name, "yes", reason)
    # A goal that the arm keeps up with puts a lower bound on the limit, no more.
    return Finding(name, "weak" if fastest > 3.0 else "no", reason, "a step of the goal by 1 rad or more")


def zero_offset(motions: Sequence[Motion]) -> Finding:
    """A wrong zero tilts gravity: it pulls more on one side of the vertical than on the other."""
    name = "zero offset"
    loaded = [one for one in motions if one.gravity and one.control == "position"]
    if not loaded:
        if any(one.control == "voltage" for one in motions):
            return Finding(name, "no", "open-loop voltage: no goal whose zero could be off")
        return Finding(name, "no", "a bare horn: nothing pulls it down" if is_bare(motions) else "no known load", LOAD)
    low, high = min(one.detail.low for one in loaded), max(one.detail.high for one in loaded)
    reason = f"the arm moves from {low:.2f} to {high:.2f} rad"
    if low < -_SIDE and high > _SIDE:
        return Finding(name, "yes", reason)
    record = "the arm moved to both sides of the vertical (sin_sin)"
    return Finding(name, "weak", f"{reason}, on one side of the vertical", record)


def small_errors(motions: Sequence[Motion]) -> Finding:
    """Punch and backlash act on errors of some counts: the encoder must show them, and they must occur."""
    name = "punch and backlash"
    driven = [one for one in motions if one.control == "position" and one.has_drive]
    if not driven:
        return Finding(name, "no", "no goal angles: there is no error to see")
    count = min(one.quantum for one in driven)
    seconds = sum(one.detail.small_errors for one in driven)
    reason = f"{seconds:.1f} s with errors of one count ({1e3 * count:.1f} mrad) to {1e3 * SMALL:.0f} mrad"
    if count > SMALL / 5:
        return Finding(name, "no", f"the position comes in steps of {1e3 * count:.1f} mrad, too coarse for it")
    record = "small steps of the goal, of 2 to 20 mrad, at the lowest gain"
    if seconds < 5.0 * _ENOUGH:
        return Finding(name, "weak" if seconds > _ENOUGH else "no", reason, record)
    return Finding(name, "yes", reason)
