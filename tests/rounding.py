"""Rounding that is disturbed on purpose, so that a result that depends on it is noticed anywhere.

`python -m tests.rounding` names NumPy's vector extensions on this processor, as the environment
variable NPY_DISABLE_CPU_FEATURES turns them off.
"""

from typing import Any

import numpy as np
from numpy._core import _multiarray_umath

from lampest import Array, Readings, Scene

DISTURBED_BITS = 9  # the last of 53, a relative 1e-13: hundreds of times one operation's rounding
SEED = 0x9E3779B97F4A7C15  # odd: multiplied with the bits of a number, it spreads them evenly


def disturbed(values: Array) -> Array:
    """Return readings whose last bits are drawn from the other ones.

    Equal readings change equally, and one that is disturbed twice changes once.
    """
    bits = np.ascontiguousarray(values, dtype=float).view(np.uint64)
    kept = bits >> np.uint64(DISTURBED_BITS)
    drawn = (kept * np.uint64(SEED)) >> np.uint64(64 - DISTURBED_BITS)
    changed = ((kept << np.uint64(DISTURBED_BITS)) | drawn).view(float)
    return np.where(np.isfinite(values), changed, values)


def disturb_readings(monkeypatch: Any) -> None:
    """Disturb the recorded values at the one door through which all readings pass."""
    original = Readings.of.__func__

    def of(
        cls: type[Readings], scene: Scene, recorded: Array, sigma: Array | None = None
    ) -> Readings:
        numbers = isinstance(recorded, np.ndarray) and recorded.dtype == float
        result: Readings = original(cls, scene, disturbed(recorded) if numbers else recorded, sigma)
        return result

    monkeypatch.setattr(Readings, "of", classmethod(of))


def vector_extensions() -> list[str]:
    """Return the extensions that NumPy found on this processor, and may do without."""
    features = _multiarray_umath.__cpu_features__
    return [name for name in _multiarray_umath.__cpu_dispatch__ if features[name]]


if __name__ == "__main__":
    print(*vector_extensions())
