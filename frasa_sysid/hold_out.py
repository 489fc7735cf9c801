"""Which recordings a fit holds out, by a rule of the command line."""

from collections.abc import Sequence

from frasa_sysid.errors import UsageError
from frasa_sysid.recording import Recording


def split(recordings: Sequence[Recording], rule: str) -> tuple[list[Recording], list[Recording]]:
    """Training and held-out recordings.

    Args:
        recordings: all of them.
        rule: `none`; `kp=24`, `mass=0.969`, `length=0.1`, `trajectory=sin_sin`; or `kp`, `rig`,
            `trajectory`, which hold out the largest gain, the rig with the largest moment and the
            last trajectory in alphabetical order.

    Raises:
        UsageError: an unknown rule, or one that leaves nothing on either side.
    """
    if rule == "none":
        return list(recordings), []
    key, _, wanted = rule.partition("=")
    facts = [_fact(one, key) for one in recordings]
    known = sorted({fact for fact in facts if fact is not None}, key=lambda fact: (str(type(fact)), fact))
    chosen = _parse(wanted, known, rule) if wanted else (known[-1] if known else None)
    held = [one for one, fact in zip(recordings, facts, strict=True) if fact == chosen]
    train = [one for one, fact in zip(recordings, facts, strict=True) if fact != chosen]
    if not held or not train:
        raise UsageError(
            f"--hold-out {rule} leaves {len(train)} runs to fit and {len(held)} to hold out; the logs have {key} = "
            + (", ".join(str(fact) for fact in known) or "nothing")
        )
    return train, held


def _fact(recording: Recording, key: str) -> float | str | None:
    rig = recording.rig
    if key == "kp":
        return rig.firmware_gain
    if key == "rig":
        return round((rig.mass or 0.0) * (rig.length or 0.0), 6)
    if key in ("mass", "length"):
        fact: float | None = getattr(rig, key)
        return fact
    if key == "trajectory":
        return rig.trajectory
    raise UsageError(f"--hold-out {key}: expected none, kp, rig, mass, length or trajectory, each also as KEY=VALUE")


def _parse(wanted: str, known: Sequence[float | str], rule: str) -> float | str:
    """The known fact a word means: the very text, or the nearest number within 1e-3."""
    if wanted in known:
        return wanted
    try:
        number = float(wanted)
    except ValueError:
        raise UsageError(f"--hold-out {rule}: the logs have {', '.join(str(fact) for fact in known)}") from None
    near = [fact for fact in known if isinstance(fact, float) and abs(fact - number) < 1e-3]
    return near[0] if near else number
