"""The servos that come with frasa, and those of a user's own tables (`servo_table`)."""

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from types import MappingProxyType

from frasa_sysid.errors import InputError, UsageError
from frasa_sysid.servo_table import ServoTable, parse_servo
from frasa_sysid.servo_type import Servo

__all__ = ["NOMINAL", "PUBLISHED_M4", "TABLES", "Servo", "find_table", "is_table", "read_servo", "servo"]

FOLDER = "servos"
_LARGEST = 2**16  # [bytes]


def _come_with_frasa() -> dict[str, ServoTable]:
    files = [one for one in (resources.files("frasa_sysid") / FOLDER).iterdir() if one.name.endswith(".toml")]
    found = [parse_servo(one.name, one.read_bytes()) for one in files]
    return {one.servo.name: one for one in sorted(found, key=lambda one: one.servo.name)}


TABLES: Mapping[str, ServoTable] = MappingProxyType(_come_with_frasa())

# Coulomb-viscous (M1) numbers: what fits start from and what "nominal" means for servos the robot has not.
NOMINAL: Mapping[str, Servo] = MappingProxyType({name: one.servo for name, one in TABLES.items()})

# M4 numbers: the truth of the simulated bench logs.
PUBLISHED_M4: Mapping[str, Servo] = MappingProxyType(
    {name: one.simulated for name, one in TABLES.items() if one.simulated is not None}
)


def servo(name: str, table: Mapping[str, Servo] = NOMINAL) -> Servo:
    """The servo of that name.

    Raises:
        UsageError: unknown; the message lists the known ones.
    """
    if name not in table:
        raise UsageError(f"unknown servo '{name}': known are {', '.join(sorted(table))}")
    return table[name]


def is_table(word: str) -> bool:
    """Whether what a user gave as a servo is a file, and no name."""
    return word.endswith(".toml")


def read_servo(path: Path) -> ServoTable:
    """A servo from a file.

    Raises:
        InputError: no such file, or a table that cannot be used.
    """
    if not path.is_file():
        raise InputError(f"no servo table at {path}: frasa-sysid servos --new NAME prints one to fill in")
    if path.stat().st_size > _LARGEST:
        raise InputError(f"servo table {path} has {path.stat().st_size} bytes: expected a small TOML file")
    return parse_servo(str(path), path.read_bytes())


def find_table(word: str, model: Path | None = None) -> ServoTable:
    """The table that a user means.

    Args:
        word: a file that ends in .toml; or a name: of a table in the folder `servos` beside the model, else of one
            that comes with frasa.
        model: of the robot.

    Raises:
        InputError: a table that cannot be used.
        UsageError: nobody knows the name.
    """
    if is_table(word):
        return read_servo(Path(word))
    beside = None if model is None else model.parent / FOLDER / f"{word}.toml"
    if beside is not None and beside.is_file():
        found = read_servo(beside)
        if found.servo.name != word:
            raise InputError(f"servo table {beside}: name = '{found.servo.name}', expected that of the file")
        return found
    if word not in TABLES:
        raise UsageError(
            f"unknown servo '{word}': known are {', '.join(sorted(TABLES))}; for another one give a table: "
            "frasa-sysid servos --new NAME prints one to fill in"
        )
    return TABLES[word]
