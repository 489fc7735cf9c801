"""Which servo logs are of: what they say themselves, and what a command line may add to it."""

from collections.abc import Sequence

from frasa_sysid.errors import LogError, UsageError
from frasa_sysid.recording import Recording


def servo_name(recordings: Sequence[Recording], given: str | None, own_table: bool = False) -> str:
    """The servo that all recordings are of. What logs say is never overruled by a name.

    Args:
        recordings: of one servo; some may leave open of which.
        given: name on the command line, or that in a table given there.
        own_table: it is that of a user's own table, whose numbers may stand for the servo that the logs name.

    Raises:
        LogError: the logs are of several servos, or nobody says of which.
        UsageError: logs and command line say different servos.
    """
    said = _said(recordings)
    if len(said) > 1:
        raise LogError(f"the logs are of several servos, {', '.join(said)}: give each servo's logs alone")
    if given is None and not said:
        raise LogError("the logs do not say which servo they are of; give --servo NAME_OR_TABLE")
    if given is None:
        return said[0]
    if said and said[0] != given and not own_table:
        raise UsageError(
            f"the logs say {said[0]}, --servo says {given}: leave --servo out, or import the logs again with "
            f"--servo {given} if they are wrong"
        )
    return given


def stands_in(recordings: Sequence[Recording], name: str, table: str) -> str:
    """That a table stands for the servo that logs name, in words; empty where they name the table's or none.

    Args:
        recordings: of one servo.
        name: in the table.
        table: the file as it was given.
    """
    said = [one for one in _said(recordings) if one != name]
    return f"the logs say {', '.join(said)}; the numbers are those of {name}, from {table}" if said else ""


def _said(recordings: Sequence[Recording]) -> list[str]:
    return sorted({one.rig.servo for one in recordings if one.rig.servo})
