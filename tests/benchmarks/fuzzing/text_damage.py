"""Damage to a text: its numbers, words, lines and columns."""

import random
import re

from fuzzing.bytes_damage import damage_bytes

TOKEN = re.compile(rb'-?\d+\.?\d*(?:[eE][-+]?\d+)?|[A-Za-z_]\w*|"[^"\n]*"')
NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
INSTEAD = (
    b"nan", b"NaN", b"inf", b"-inf", b"Infinity", b"1e999", b"-1e308", b"1e308", b"1e-320", b"-0", b"0", b"-1", b"1",
    b"", b"2147483648", b"4294967296", b"9223372036854775808", b"18446744073709551616", b"9" * 400, b"9" * 5000,
    b"true", b"null", b'"x"', b"[]", b"{}", b"0x" + b"f" * 6000, b"1_000", b"1:2:3", b"1e5", b"100000000", b"1e9",
    b"-5", b"\xff", b"\x00", "é".encode(), "\u2028".encode(), b"..", b"../../x", b"/etc/passwd", b"*", b"&a",
    b"!!python/name:os.system", b"'", b'"', b"<!--", b"a" * 3000, b"%s%n", b"0.5 0.5 0.5",
)  # fmt: skip


def damage_text(content: bytes, rng: random.Random) -> bytes:
    """A damaged copy."""
    kind = rng.randrange(12)
    if kind < 5:
        return _token(content, rng, NUMBER if kind < 3 else TOKEN)
    if kind == 5:
        return damage_bytes(content, rng)
    lines = content.splitlines(keepends=True)
    if not lines:
        return rng.choice(INSTEAD)
    at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    if kind == 6:
        lines[at], lines[other] = lines[other], lines[at]
    elif kind == 7:
        del lines[at : at + rng.choice((1, 1, 5))]
    elif kind == 8:
        lines[at:at] = [lines[other]] * rng.choice((1, 2, 50))
    elif kind == 9:
        lines[at] = lines[at][: rng.randrange(len(lines[at]) + 1)]
    elif kind == 10:
        lines[at] = lines[at].rstrip() + rng.choice((b",1", b" ", b"\t", b";", b"\r\n", b"\x00", b"\xff\xfe")) + b"\n"
    else:
        return rng.choice((b"\xef\xbb\xbf", b"\xff\xfe", b"\n", b"#", b"---\n", b"[")) + content
    return b"".join(lines)


def _token(content: bytes, rng: random.Random, pattern: "re.Pattern[bytes]") -> bytes:
    found = list(pattern.finditer(content, rng.randrange(max(len(content) - 200, 1))))[:400]
    if not found:
        return damage_bytes(content, rng)
    one = rng.choice(found)
    return content[: one.start()] + rng.choice(INSTEAD) + content[one.end() :]
