"""Damage to bytes, whatever they mean: cut, flipped, doubled, swapped, overwritten with telling numbers."""

import random
import struct

WHOLE = (0, 1, 2, 7, 8, 127, 128, 255, 256, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**40, 2**62)
WHOLE += (2**63 - 1, 2**63, 2**64 - 1)
FLOATS = (float("nan"), float("inf"), float("-inf"), 1e308, -1e308, 5e-324, 0.0, -0.0)


def damage_bytes(content: bytes, rng: random.Random) -> bytes:
    """A damaged copy; never more than a little longer."""
    data = bytearray(content)
    if not data:
        return bytes(rng.randrange(256) for _ in range(rng.randrange(20)))
    at = rng.randrange(len(data))
    length = min(len(data) - at, rng.choice((1, 2, 4, 8, 16, 64, 512)))
    kind = rng.randrange(10)
    if kind == 0:
        return bytes(data[:at])
    if kind == 1:
        for _ in range(rng.choice((1, 1, 2, 8, 64))):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif kind == 2:
        data[at : at + length] = bytes(rng.randrange(256) for _ in range(length))
    elif kind == 3:
        del data[at : at + length]
    elif kind == 4:
        data[at:at] = data[at : at + length] * rng.choice((1, 2, 16))
    elif kind == 5:
        data[at:at] = bytes(rng.randrange(256) for _ in range(length))
    elif kind == 6:
        size = rng.choice((1, 2, 4, 8))
        data[at : at + size] = (rng.choice(WHOLE) % 2 ** (8 * size)).to_bytes(size, rng.choice(("little", "big")))
    elif kind == 7:
        data[at : at + 8] = struct.pack("<d", rng.choice(FLOATS))
    elif kind == 8:
        other = rng.randrange(len(data))
        piece = data[other : other + length]
        data[at : at + len(piece)] = piece
    else:
        data[at : at + length] = bytes([rng.choice((0, 255, 0x80, 0x22, 0x0A))]) * length
    return bytes(data)
