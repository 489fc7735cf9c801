"""State as plain arrays by name: what a checkpoint keeps of anything, without pickling."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Arrays = dict[str, np.ndarray[Any, Any]]


def taken(owner: object, names: Sequence[str]) -> Arrays:
    """Copies of the arrays that are attributes of an object."""
    return {name.lstrip("_"): np.array(getattr(owner, name)) for name in names}


def put_back(owner: object, names: Sequence[str], kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
    """Write kept arrays into the attributes they came from, in place.

    Raises:
        KeyError: one is missing.
        ValueError: one has another shape or type than the attribute.
    """
    for name in names:
        mine, value = getattr(owner, name), kept[name.lstrip("_")]
        if mine.shape != value.shape or mine.dtype != value.dtype:
            raise ValueError(
                f"{name.lstrip('_')} is {value.dtype} of shape {value.shape}, expected {mine.dtype} of {mine.shape}"
            )
        mine[...] = value


def nested(name: str, arrays: Mapping[str, np.ndarray[Any, Any]]) -> Arrays:
    """The arrays of a part, under its name."""
    return {f"{name}.{key}": value for key, value in arrays.items()}


def part(name: str, arrays: Mapping[str, np.ndarray[Any, Any]]) -> Arrays:
    """The other way round."""
    return {key.removeprefix(f"{name}."): arrays[key] for key in arrays if key.startswith(f"{name}.")}


def state_of(rngs: Sequence[np.random.Generator]) -> np.ndarray[Any, Any]:
    """States of generators as text, shape (generators,)."""
    return np.array([json.dumps(rng.bit_generator.state) for rng in rngs])


def set_states(rngs: Sequence[np.random.Generator], kept: np.ndarray[Any, Any]) -> None:
    """The other way round.

    Raises:
        ValueError: states of other generators, or of another number of them.
    """
    for rng, said in zip(rngs, kept, strict=True):
        try:
            rng.bit_generator.state = json.loads(str(said))
        except (TypeError, KeyError) as error:
            raise ValueError(f"not the state of a generator: {error}") from error
