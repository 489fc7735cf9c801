"""Where the numbers of a message stand in its bytes, learned from its decoder, to read a million alike at once.

Messages of one size on one channel differ in their stamp and in their numbers, hardly ever in anything else. So one of
them is decoded again and again with a few bytes changed: eight bytes that turn up as exactly one number of a reading,
and change nothing else, are that number's place. A message whose other bytes are those of the sample says the same in
the same places; any other message goes to the decoder. What a number means is known to the decoder only, so there is
nothing here that could come to disagree with it.
"""

import struct
from array import array
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from frasa_sysid.readers.decoders import Decode, Decoded, Reading
from frasa_sysid.recording import FloatArray

Bytes = npt.NDArray[np.uint8]
Bools = npt.NDArray[np.bool_]
NUMBER = 8  # bytes
STEP = 4  # bytes that CDR aligns everything to at least
STAMP = 4  # byte at which a header's stamp stands: the header is first, behind four bytes of encoding
LARGEST = 2**16  # bytes of a message that is worth the trouble
MARKS = (0.7390851332151607, -1.2345678901234567e101)
FILLINGS = (b"\xff\xff\xff\xff", b"\x01\x02\x03\x04", b"\x00\x00\xf0\xbf")
SECOND = 10**9


class Place(NamedTuple):
    """One reading of a message: what it is, and at which bytes its k numbers stand."""

    reading: Reading
    offsets: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Layout:
    """Messages of one kind and size.

    Attributes:
        sample: one of them, shape (size,).
        fixed: ranges of bytes that have to be the sample's.
        stamped: a header stamp stands at `STAMP`.
        places: of all readings.
    """

    sample: Bytes
    fixed: tuple[tuple[int, int], ...]
    stamped: bool
    places: tuple[Place, ...]

    def matches(self, rows: Bytes) -> Bools:
        """Which of n messages (n, size) have this layout, shape (n,)."""
        alike = np.ones(len(rows), dtype=bool)
        for begin, end in self.fixed:
            alike &= (rows[:, begin:end] == self.sample[begin:end]).all(axis=1)
        if self.stamped:
            # Seconds since 1970 are read as signed or not: in what has to come, the decoder decides.
            alike &= rows[:, STAMP + 3] < 0x80
        return alike

    def stamps(self, rows: Bytes) -> npt.NDArray[np.uint64]:
        """Header stamps [ns] of n messages (n, size); 0 without one, shape (n,)."""
        if not self.stamped:
            return np.zeros(len(rows), np.uint64)
        parts = np.ascontiguousarray(rows[:, STAMP : STAMP + 8]).view("<u4").astype(np.uint64)
        return np.asarray(parts[:, 0] * np.uint64(SECOND) + parts[:, 1])

    def values(self, rows: Bytes, place: Place) -> FloatArray:
        """The numbers of one reading of n messages (n, size), shape (n, k)."""
        first, count = int(place.offsets[0]), place.offsets.size
        if (np.diff(place.offsets) == NUMBER).all():
            found = rows[:, first : first + NUMBER * count]
        else:
            found = rows[:, (place.offsets[:, None] + np.arange(NUMBER)).ravel()]
        return np.ascontiguousarray(found).view("<f8").astype(np.float64, copy=False)


def learn(decode: Decode, sample: bytes) -> Layout | None:
    """The layout of messages like a sample, or None where they have to be decoded one by one.

    Args:
        decode: of their channel; what it says depends on the bytes alone.
        sample: one message that it decodes.
    """
    if len(sample) > LARGEST:
        return None
    try:
        base = decode(sample)
    except Exception:  # generated from the file's own definition: anything may come out
        return None
    probe = _Probe(decode, sample, base)
    places = probe.places()
    if places is None:
        return None
    stamped = base.stamp is not None
    if stamped and not probe.has_stamp():
        return None
    free = np.zeros(len(sample), dtype=bool)
    free[STAMP : STAMP + 8] = stamped
    for offset in sorted(offset for place in places for offset in place.offsets.tolist()):
        free[offset : offset + NUMBER] = True
        # Bytes between a list's length and its numbers are there for alignment; nobody fills them in.
        if not free[offset - STEP : offset].any() and probe.is_filling(offset - STEP):
            free[offset - STEP : offset] = True
    edges = np.flatnonzero(np.diff(np.concatenate([[True], free, [True]]).astype(np.int8)))
    fixed = tuple((int(a), int(b)) for a, b in edges.reshape(-1, 2))
    return Layout(np.frombuffer(sample, np.uint8), fixed, stamped, tuple(places))


class _Probe:
    """One message, decoded with some bytes changed."""

    def __init__(self, decode: Decode, sample: bytes, base: Decoded) -> None:
        self._decode, self._sample, self._stamp = decode, sample, base.stamp
        self._readings = base.readings
        self._numbers = _numbers(base)

    def places(self) -> list[Place] | None:
        """Where all numbers of all readings stand; None unless each of them has its place."""
        if not self._numbers:
            return None
        found: dict[int, int] = {}
        for offset in range(STEP, len(self._sample) - NUMBER + 1, STEP):
            first = self._marked(offset, MARKS[0])
            if first is not None and first == self._marked(offset, MARKS[1]):
                if first in found:
                    return None
                found[first] = offset
        if len(found) != len(self._numbers):
            return None
        places, begin = [], 0
        for reading in self._readings:
            end = begin + len(reading.values)
            places.append(Place(reading, np.array([found[i] for i in range(begin, end)], np.int64)))
            begin = end
        return places if all(place.offsets.size for place in places) else None

    def has_stamp(self) -> bool:
        """Whether seconds and nanoseconds at `STAMP` are the stamp."""
        times = ((1_234_567_890, 987_654_321), (1_700_000_001, 5))
        return all(self._same(struct.pack("<II", s, ns), STAMP, s * SECOND + ns) for s, ns in times)

    def is_filling(self, offset: int) -> bool:
        """Whether the four bytes there mean nothing."""
        return offset >= STAMP + 8 and all(self._same(filling, offset, self._stamp) for filling in FILLINGS)

    def _marked(self, offset: int, mark: float) -> int | None:
        """Which number, of all readings one after the other, the eight bytes there are; None for none."""
        decoded = self._with(struct.pack("<d", mark), offset)
        if decoded is None or decoded.stamp != self._stamp or not self._alike(decoded):
            return None
        found = _numbers(decoded)
        # Compared as bits: NaN is a value like any other here.
        changed = np.flatnonzero(np.frombuffer(found, np.uint64) != np.frombuffer(self._numbers, np.uint64))
        return int(changed[0]) if changed.size == 1 and found[changed[0]] == mark else None

    def _same(self, part: bytes, offset: int, stamp: int | None) -> bool:
        """Whether all readings are as they were with some bytes replaced, and the stamp as expected."""
        decoded = self._with(part, offset)
        if decoded is None or decoded.stamp != stamp or not self._alike(decoded):
            return False
        return _numbers(decoded).tobytes() == self._numbers.tobytes()

    def _with(self, part: bytes, offset: int) -> Decoded | None:
        try:
            return self._decode(self._sample[:offset] + part + self._sample[offset + len(part) :])
        except Exception:  # bytes that make no message
            return None

    def _alike(self, decoded: Decoded) -> bool:
        """Whether readings are of the same quantities and joints, and as many."""
        return [(*one[:3], len(one.values)) for one in decoded.readings] == [
            (*one[:3], len(one.values)) for one in self._readings
        ]


def _numbers(decoded: Decoded) -> "array[float]":
    return array("d", [float(value) for one in decoded.readings for value in one.values])
