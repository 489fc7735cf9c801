"""A Dask cluster for whoever has work for one; the package is optional."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from frasa_sysid.calibration.errors import UsageError


@contextmanager
def dask_client(address: str) -> Iterator[Any]:
    """A `distributed.Client`, for as long as it is needed.

    Args:
        address: of a scheduler, such as `tcp://host:8786`.

    Raises:
        UsageError: `distributed` is not installed, or nobody answers at the address.
    """
    client = _connected(address)
    try:
        yield client
    finally:
        client.close()


def _connected(address: str) -> Any:  # noqa: ANN401 (the package is optional)
    try:
        from distributed import Client
    except ImportError:
        raise UsageError("--cluster needs Dask: pip install 'frasa[cluster]'") from None
    try:
        connect: Any = Client  # it carries no types
        return connect(address, timeout="10s")
    except (OSError, ValueError) as error:
        why = str(error)
    # The client that found nobody closes itself when it is collected. Should that happen while another
    # client starts, it would wait for a lock that its own thread holds: so it is collected here.
    gc.collect()
    raise UsageError(f"--cluster {address}: no Dask scheduler answers there ({why})")
